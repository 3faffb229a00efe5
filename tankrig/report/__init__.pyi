from .beside_reference import Validation as Validation
from .beside_reference import validated as validated
from .report import write_report as write_report
from .validation import fitted_as as fitted_as
from .validation import validation_of as validation_of
from .validation import write_validation as write_validation
