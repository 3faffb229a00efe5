"""From a scene to the camera's image: the models of light scattering."""
