"""Training: motion and virtual sensors in, weights with their description out."""
