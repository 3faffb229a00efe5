from .expected import Expected as Expected
from .expected import Known as Known
from .expected import Shot as Shot
from .ranking import Advice as Advice
from .ranking import Candidate as Candidate
from .ranking import ranked as ranked
from .starting import from_guess as from_guess
from .starting import from_run as from_run
