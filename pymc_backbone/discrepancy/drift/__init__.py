"""What changes with time instead of amplitude: a rival of every set."""
