from .report import write_report as write_report
from .validation import validation_of as validation_of
from .validation import write_validation as write_validation
