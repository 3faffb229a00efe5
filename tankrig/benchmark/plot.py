"""Error against time, one line per model."""

from pathlib import Path

from tankrig.benchmark.race import Race


def plot(race: Race, path: Path) -> None:
    """Draw every result on logarithmic axes, a panel per case; what is extrapolated is dashed.

    Raises
    ------
    StoreError
        When the picture cannot be written.
    """
    from matplotlib.figure import Figure

    from tankrig.files import whole_file

    cases = list(dict.fromkeys(result.case for result in race.results))
    columns = min(3, len(cases)) or 1
    rows = -(-len(cases) // columns) or 1
    figure = Figure(figsize=(4.2 * columns, 3.4 * rows), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
    for panel, case in zip(panels, cases, strict=False):
        here = [result for result in race.results if result.case == case]
        for index, model in enumerate(dict.fromkeys(result.model for result in race.results)):
            found = sorted((one.seconds, one.error) for one in here if one.model == model)
            # An error that drowns in the reference's noise is drawn at the bottom.
            shown = [max(100.0 * error, 0.01) for _, error in found]
            panel.loglog([x for x, _ in found], shown, "o-", ms=4, color=f"C{index}", label=model)
            for equal in race.equal:
                if found and (equal.case, equal.model) == (case, model) and equal.extrapolated > 1.0:
                    ends = [found[-1][0], equal.seconds], [shown[-1], 100.0 * equal.error]
                    panel.loglog(*ends, "--", lw=1.0, color=f"C{index}")
        panel.axhline(100.0 * here[0].noise, color="0.6", lw=0.8, ls=":")
        panel.set_title(case)
        panel.grid(alpha=0.3)
    for panel in panels[len(cases) :]:
        panel.set_axis_off()
    panels[0].legend(fontsize="small")
    figure.supxlabel("seconds, cold")
    figure.supylabel("error in % (relative L2, net of the reference's noise; dotted: that noise)")
    with whole_file(path) as unfinished:
        figure.savefig(unfinished, dpi=120)
