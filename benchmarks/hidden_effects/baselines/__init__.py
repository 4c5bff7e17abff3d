"""Three baseline methods that name the missing effect in free decays: PySINDy, stepwise least squares, closed form."""
