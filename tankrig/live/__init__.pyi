from .attached import fitted_live as fitted_live
from .brackets import merged_of_run as merged_of_run
from .live_fit import LiveFit as LiveFit
from .results import DoseFit as DoseFit
from .results import FailedFit as FailedFit
from .results import SeriesFit as SeriesFit
