"""`tankrig export`: a run in a form that other programs read."""

import json
from pathlib import Path

import click

from ui.cli.options import json_option


@click.command(epilog="Example: tankrig export runs/2026-11-20T10-00-00 --out run.nxs")
@click.argument("run", metavar="RUN", type=click.Path(path_type=Path))
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    metavar="PATH",
    required=True,
    help="run.nxs: NeXus; run.nc: NetCDF; run.jsonl: Bluesky documents, one on each line; a folder: TIFF files.",
)
@json_option
def export(run: Path, out: Path, as_json: bool) -> None:
    """Write RUN as NeXus, NetCDF, Bluesky documents or TIFF files, by the name of --out.

    Bluesky documents say where the frames are, and copy none; the others hold all frames.
    """
    from tankrig.run.reading import open_run

    opened = open_run(run)
    if out.suffix == ".nxs":
        from tankrig.archive.nexus import export_nexus

        export_nexus(opened, out)
    elif out.suffix == ".jsonl":
        from tankrig.archive.documents import write_documents

        write_documents(opened, out)
    elif out.suffix == ".nc":
        from tankrig.run.export import export_netcdf

        export_netcdf(opened, out)
    elif out.suffix == "":
        from tankrig.run.export import export_tiff

        export_tiff(opened, out)
    else:
        raise click.UsageError(f"{out} ends in {out.suffix}; give .nxs, .nc, .jsonl, or a folder")
    click.echo(json.dumps({"out": str(out)}) if as_json else f"written  {out}")
