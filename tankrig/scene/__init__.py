"""What is in the tank, what lights it and what looks at it."""

from tankrig.scene.description import Beam, Camera, Medium, Projector, Scene, Tank
from tankrig.scene.loading import load_scene

__all__ = ["Beam", "Camera", "Medium", "Projector", "Scene", "Tank", "load_scene"]
