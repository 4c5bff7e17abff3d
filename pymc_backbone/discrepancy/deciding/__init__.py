"""From sets and their probabilities to mechanisms, laws and a verdict."""
