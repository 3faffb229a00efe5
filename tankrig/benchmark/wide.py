"""Random scenes over all that the models are said to hold for, and how well predictions keep what they promise there.

Truth is noisy too. With two independent truths t₁ and t₂ of a scene, the error of a prediction p is

    ‖p − truth‖² = E⟨p − t₁, p − t₂⟩

without the noise of either; with one truth and its standard error, it is ‖p − t‖² − Σ stderr².
"""

from dataclasses import dataclass

import numpy as np

from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank

EXTINCTION_PER_MM = (0.003, 0.11)
ABSORBED = (0.0005, 0.5)
"""1 − ϖ."""
ASYMMETRY = (-0.4, 0.96)
KINDS = ("parallel", "parallel", "pinholes")
"""In turn: a third of the scenes has two pinholes, every other of those with light bent at wall and surface."""


@dataclass(frozen=True)
class WideScene:
    """A random scene.

    Parameters
    ----------
    name
        Its number and kind.
    kind
        "parallel", "pinholes" or "bent".
    scene
        The scene itself.
    """

    name: str
    kind: str
    scene: Scene


def wide_scene(number: int, seed: int = 0) -> WideScene:
    """One of the random scenes.

    Parameters
    ----------
    number
        Which; the kind goes with it.
    seed
        Of the whole set.

    Examples
    --------
    >>> wide_scene(0) == wide_scene(0), wide_scene(2).kind, wide_scene(5).kind
    (True, 'pinholes', 'bent')
    """
    numbers = np.random.default_rng((seed, number))
    sigma_t = float(np.exp(numbers.uniform(*np.log(EXTINCTION_PER_MM))))
    absorbed = float(np.exp(numbers.uniform(*np.log(ABSORBED))))
    medium = Medium(sigma_t * absorbed, sigma_t * (1.0 - absorbed), float(numbers.uniform(*ASYMMETRY)))
    kind = KINDS[number % len(KINDS)]
    if kind == "pinholes" and number % (2 * len(KINDS)) >= len(KINDS):
        kind = "bent"
    beams = _beams(numbers)
    if kind == "parallel":
        surface = "fresnel" if numbers.random() < 0.3 else "matched"
        scene = Scene(
            Tank(surface=surface), medium, Projector("collimated", beams), Camera("orthographic", (80, 120), 2.0)
        )  # type: ignore[arg-type]
    else:
        y, above = float(numbers.choice([0.0, numbers.uniform(-30.0, 30.0)])), float(numbers.uniform(350.0, 650.0))
        light = Projector("pinhole", beams, (float(numbers.uniform(-500.0, -250.0)), y, float(numbers.uniform(40, 80))))
        camera = Camera("pinhole", (80, 120), 2.0, (float(numbers.uniform(90.0, 150.0)), y, 120.0 + above))
        tank = Tank(surface="fresnel", entry="glass", wall_mm=8.0) if kind == "bent" else Tank()
        scene = Scene(tank, medium, light, camera)
    return WideScene(f"{number:03d}-{kind}", kind, scene)


def _beams(numbers: np.random.Generator) -> tuple[Beam, ...]:
    """One to seven beams side by side, at one height or at two, or one broad sheet."""
    if numbers.random() < 0.15:
        half, low = numbers.uniform(30.0, 60.0), numbers.uniform(40.0, 80.0)
        return (Beam((-half, half), (low, low + 4.0)),)
    count = int(numbers.integers(1, 8))
    pitch = 140.0 / count
    wide, offset = numbers.uniform(3.0, min(10.0, 0.6 * pitch)), numbers.choice([0.0, numbers.uniform(-4.0, 4.0)])
    heights = [float(numbers.uniform(35.0, 85.0)) for _ in range(2 if numbers.random() < 0.25 else 1)]
    thick = float(numbers.uniform(2.0, 8.0))
    middles = [offset + pitch * (index - 0.5 * (count - 1)) for index in range(count)]
    return tuple(
        Beam((float(middle - 0.5 * wide), float(middle + 0.5 * wide)), (height, height + thick))
        for middle, height in zip(middles, heights * count, strict=False)
    )
