"""Which rig the window works with: a rig file, or the simulated rig of its own folder."""

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from tankrig.errors import StoreError, TankrigError

if TYPE_CHECKING:
    from drivers.rig import RigFile


@dataclass(frozen=True)
class RigSource:
    """Where the rig's description comes from.

    Parameters
    ----------
    file
        A rig file; None for the simulated rig.
    folder
        Where the simulated rig remembers its tank.
    """

    file: Path | None
    folder: Path

    @property
    def simulated(self) -> bool:
        """Whether nobody has configured a rig."""
        return self.file is None

    def description(self) -> "RigFile":
        """Read it.

        Raises
        ------
        SceneError
            When the rig file is wrong.
        """
        from drivers.rig import load_rig_file, simulated_rig

        return simulated_rig(self.folder) if self.file is None else load_rig_file(self.file)

    def refill(self) -> str:
        """The tank has been emptied and filled with fresh water: set its ledger aside, and begin a new one.

        The simulated tank is emptied, too. To be called while the rig is closed.

        Returns
        -------
        str
            What was done, in words.

        Raises
        ------
        StoreError
            When the ledger cannot be set aside.
        """
        ledger = self.description().ledger
        old = ledger.parent if self.simulated else ledger
        kept = old.with_name(f"{old.name}.until-{datetime.now():%Y-%m-%dT%H-%M-%S}")
        try:
            if old.exists():
                old.rename(kept)
        except OSError as error:
            raise StoreError(
                f"{old}: cannot be set aside ({error.strerror}); check its folder's permissions"
            ) from error
        return f"a new ledger begins with clear water; the old one is kept as {kept}"


def described(source: RigSource) -> "tuple[RigFile | None, str]":
    """The description, or None and the sentence that says what is wrong with it."""
    try:
        return source.description(), ""
    except TankrigError as error:
        return None, str(error)
