"""Light that the tank's walls and floor send back: what is added to the image of a tank whose walls are black."""
