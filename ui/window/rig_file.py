"""Which rig the window works with: a rig file, or the simulated rig of its own folder."""

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tankrig.errors import SceneError, StoreError
from ui.window.pump_rate import at_rate

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
    rate_ul_per_s
        At which a person has the pump deliver while this window is open; None for the rig file's own rate.
    """

    file: Path | None
    folder: Path
    rate_ul_per_s: float | None = None

    @property
    def simulated(self) -> bool:
        """Whether nobody has configured a rig."""
        return self.file is None

    def description(self) -> "RigFile":
        """Read it.

        Raises
        ------
        SceneError
            When the rig file is wrong, or its pump does not take the rate.
        """
        from drivers.rig import load_rig_file, simulated_rig

        rig = simulated_rig(self.folder) if self.file is None else load_rig_file(self.file)
        return rig if self.rate_ul_per_s is None else at_rate(rig, self.rate_ul_per_s)

    def choose_screen(self, identity: dict[str, str]) -> None:
        """Write into the rig file which screen the projector is.

        Parameters
        ----------
        identity
            As `[projector] screen` of the driver `hdmi-projector` has it.

        Raises
        ------
        SceneError
            When there is no rig file, or its projector is no screen.
        StoreError
            When the file cannot be written.
        """
        import tomlkit

        from tankrig.files import whole_file

        if self.file is None:
            raise SceneError("the simulated projector has no screen; start with --rig and a rig file of your own")
        document = tomlkit.parse(self.file.read_text(encoding="utf-8-sig"))
        projector: Any = document["projector"]
        if projector["driver"] != "hdmi-projector":
            raise SceneError(f"{self.file}: its projector is driven by {projector['driver']}, which needs no screen")
        screen = tomlkit.inline_table()
        screen.update(identity)
        projector["screen"] = screen
        with whole_file(self.file) as unfinished:
            unfinished.write_text(tomlkit.dumps(document), encoding="utf-8")

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
