from .guarded import DoseJournal as DoseJournal
from .guarded import GuardedDoser as GuardedDoser
from .guarded import NoRun as NoRun
from .ledger import TankLedger as TankLedger
from .limits import DoseLimits as DoseLimits
from .limits import Remaining as Remaining
from .records import DoseDone as DoseDone
from .records import DoseIntent as DoseIntent
