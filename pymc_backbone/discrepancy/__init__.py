"""Find where model and measurement disagree, name the missing effect, add it, and show the gap shrink."""
