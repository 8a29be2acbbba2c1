"""The catalogue of effects, and the drivers that it works out for itself."""
