from .prediction_file import write_prediction as write_prediction
from .prepare import Prepared as Prepared
from .reading import read_frame as read_frame
from .reading import read_image as read_image
from .reading import read_mask as read_mask
