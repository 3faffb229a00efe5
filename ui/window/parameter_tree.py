"""A tree of parameters that leaves nothing behind when Qt has deleted it."""

import weakref
from typing import Any

from pyqtgraph.parametertree import Parameter, ParameterTree


def parameter_tree(root: Parameter, show_top: bool = True) -> Any:
    """A tree of two columns, names and values, below `root` or from it on.

    pyqtgraph's tree keeps Python's view of Qt's root item, and Qt doesn't say when it deletes that. Whatever widget Qt
    then makes at the same address would come to Python as a tree's item, so the view is let go of with the tree.
    """
    tree: Any = ParameterTree(showHeader=False)
    tree.setParameters(root, showTop=show_top)
    alive = weakref.ref(tree)

    def forget() -> None:
        if (gone := alive()) is not None:
            gone._invRootItem = None  # noqa: SLF001 - pyqtgraph has no other way to it

    tree.destroyed.connect(forget)
    return tree
