"""What is shown of results: words, figures, reports, scripts and the output folder."""
