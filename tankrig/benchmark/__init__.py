"""Time against error, for every way this program has of making an image, measured on the machine it runs on."""
