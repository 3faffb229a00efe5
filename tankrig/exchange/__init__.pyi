from .formats import exported as exported
from .liquid import Liquid as Liquid
from .liquid import liquid_of as liquid_of
