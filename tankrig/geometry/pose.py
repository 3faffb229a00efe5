"""Where a device stands and which way it looks, as OpenCV has it: device = R · world + t."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Pose:
    """Rotation and shift from the world's frame to the device's: x to the right of its picture, y down, z forward.

    Parameters
    ----------
    rotation
        Axis of the rotation times its angle in radians (Rodrigues; OpenCV's `rvec`).
    translation_mm
        The world's origin in the device's frame (OpenCV's `tvec`).

    Examples
    --------
    >>> pose = Pose.at((120.0, 0.0, 620.0), (np.pi, 0.0, 0.0))  # looks straight down, columns along x
    >>> to_device(pose, [130.0, 0.0, 120.0]).round(9) + 0.0
    array([ 10.,   0., 500.])
    """

    rotation: Vector
    translation_mm: Vector

    @property
    def matrix(self) -> Array:
        """(3, 3) R."""
        return rotation_matrix(self.rotation)

    @property
    def centre_mm(self) -> Array:
        """(3,) the device's viewpoint in the world: −Rᵀ t."""
        return np.asarray(-self.matrix.T @ np.array(self.translation_mm))

    @classmethod
    def at(cls, centre_mm: ArrayLike, rotation: Vector) -> "Pose":
        """From the viewpoint's place in the world."""
        x, y, z = (-rotation_matrix(rotation) @ np.asarray(centre_mm, np.float64)).tolist()
        return cls(rotation, (x, y, z))

    @classmethod
    def looking(cls, centre_mm: ArrayLike, target_mm: ArrayLike, down: ArrayLike) -> "Pose":
        """From the viewpoint, a point that it looks at, and the direction in the world that is down in the picture.

        Examples
        --------
        >>> Pose.looking([120.0, 0.0, 620.0], [120.0, 0.0, 0.0], [0.0, -1.0, 0.0]).matrix.round(9).tolist()[2]
        [0.0, 0.0, -1.0]
        """
        centre = np.asarray(centre_mm, np.float64)
        forward = np.asarray(target_mm, np.float64) - centre
        forward /= np.linalg.norm(forward)
        right = np.cross(np.asarray(down, np.float64), forward)
        right /= np.linalg.norm(right)
        return cls.at(centre, rotation_vector(np.stack([right, np.cross(forward, right), forward])))


def rotation_matrix(rotation: ArrayLike) -> Array:
    """(3, 3) matrix of a rotation vector (Rodrigues' formula).

    Examples
    --------
    >>> rotation_matrix([0.0, 0.0, np.pi / 2]).round(12)[0].tolist()
    [0.0, -1.0, 0.0]
    """
    x, y, z = np.asarray(rotation, np.float64)
    angle = float(np.sqrt(x * x + y * y + z * z))
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    # sin a/a and (1 − cos a)/a² without cancellation or division by zero.
    half = np.sinc(angle / (2.0 * np.pi))
    return np.asarray(np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * half * half * (cross @ cross))


def rotation_vector(matrix: ArrayLike) -> Vector:
    """Rotation vector of a matrix.

    Examples
    --------
    >>> np.round(rotation_vector(rotation_matrix([0.1, -0.2, 3.0])), 12).tolist()
    [0.1, -0.2, 3.0]
    """
    from scipy.spatial.transform import Rotation

    x, y, z = (float(value) for value in Rotation.from_matrix(np.asarray(matrix)).as_rotvec())
    return x, y, z


def to_device(pose: Pose, points: ArrayLike) -> Array:
    """Points (…, 3) of the world in the device's frame, mm."""
    return np.asarray(np.asarray(points, np.float64) @ pose.matrix.T + np.array(pose.translation_mm))


def to_world(pose: Pose, points: ArrayLike) -> Array:
    """Points (…, 3) of the device's frame in the world, mm."""
    return np.asarray((np.asarray(points, np.float64) - np.array(pose.translation_mm)) @ pose.matrix)


def directions_to_device(pose: Pose, directions: ArrayLike) -> Array:
    """Directions (…, 3) of the world in the device's frame."""
    return np.asarray(directions, np.float64) @ pose.matrix.T


def directions_to_world(pose: Pose, directions: ArrayLike) -> Array:
    """Directions (…, 3) of the device's frame in the world."""
    return np.asarray(np.asarray(directions, np.float64) @ pose.matrix)
