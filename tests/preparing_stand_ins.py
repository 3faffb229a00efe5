"""In place of preparing: models that a test says are there, or not yet."""

from dataclasses import dataclass

from tankrig.light.prepared.about import box_for
from tankrig.light.prepared.box import Box
from tankrig.scene.description import Medium, Scene


@dataclass(frozen=True)
class Model:
    """Stands in for a prepared model."""

    box: Box
    first: bool = False


class Ready:
    """Stands in for preparing: models are there, or not yet."""

    def __init__(self) -> None:
        self.there = False
        self.all_models: list[object] = []

    def box(self, liquid: Medium) -> Box:
        return box_for(liquid)

    def want(self, *_: object) -> None: ...

    def models(self, scenes: list[Scene], box: Box) -> list[Model] | None:
        return [Model(box)] * len(scenes) if self.there else None

    def model_so_far(self, scene: Scene, box: Box) -> Model | None:
        models = self.models([scene], box)
        return models[0] if models else None

    def under_way(self, *_: object) -> bool:
        return True


class Boxes(Ready):
    """Stands in for preparing: says what was wanted, first things first, and hands out models of chosen boxes."""

    def __init__(self) -> None:
        super().__init__()
        self.wanted: list[Box] = []
        self.ready: set[Box] = set()

    def want(self, wanted: list[tuple[tuple[Scene, ...], Box]]) -> None:
        assert all(scenes for scenes, _ in wanted)
        self.wanted = list(dict.fromkeys(box for _, box in wanted))

    def models(self, scenes: list[Scene], box: Box) -> list[Model] | None:
        return [Model(box)] * len(scenes) if box in self.ready else None


class ByPattern(Boxes):
    """Models are ready by pattern, first ones and whole ones."""

    def __init__(self) -> None:
        super().__init__()
        self.first_scenes: list[Scene] = []
        self.ready_scenes: list[Scene] = []

    def models(self, scenes: list[Scene], box: Box) -> list[Model] | None:
        there = box in self.ready or set(scenes) <= set(self.ready_scenes)
        return [Model(box)] * len(scenes) if there else None

    def model_so_far(self, scene: Scene, box: Box) -> Model | None:
        return super().model_so_far(scene, box) or (Model(box, first=True) if scene in self.first_scenes else None)
