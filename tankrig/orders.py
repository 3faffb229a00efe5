"""Classes of orders of scattering that images are split into: 1, 2, 3, "4-20", ">20" scattering events."""

ORDER_CLASSES: tuple[int | str, ...] = (1, 2, 3, "4-20", ">20")
"""In ascending order, as in the reference images."""


def order_class(order: int) -> int | str:
    """Class that an order of scattering belongs to.

    Examples
    --------
    >>> order_class(2), order_class(4), order_class(21)
    (2, '4-20', '>20')
    """
    if order <= 3:
        return order
    return "4-20" if order <= 20 else ">20"
