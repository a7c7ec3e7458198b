# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The command line: parses, calls one function a command, prints.

Exit codes: 0 done, 1 the job failed, 2 wrong usage or bad input. Results go to stdout, progress and
errors to stderr. Heavy imports wait inside the commands, so `--help` is quick.
"""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Sequence

import typer

from adafusion.cli import (
    data,
    demo,
    doctor,
    evaluation,
    experiment,
    mapping,
    model,
    split,
    training,
    world,
)
from adafusion.types import JobFailed, UserError

INTERRUPTED = 130  # exit code after Ctrl-C

app = typer.Typer(
    name="adafusion",
    help="Camera + LiDAR place recognition: one image and one point cloud in, a place out.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
    rich_markup_mode=None,
)
app.command("demo")(demo.demo)
app.command("simulate")(data.simulate)
app.command("prepare")(data.prepare)
app.command("split")(split.split)
app.command("doctor")(doctor.doctor)
app.command("train")(training.train)
app.command("evaluate")(evaluation.evaluate)
app.command("experiment")(experiment.experiment)
app.add_typer(mapping.app, name="map")
app.command("locate")(mapping.locate)
app.command("import-released")(model.import_released)
app.add_typer(world.app, name="world")
app.add_typer(model.config_app, name="config")


@app.callback()
def options(
    verbose: bool = typer.Option(False, "--verbose", "-v", help="Log what happens."),
) -> None:
    """Camera + LiDAR place recognition: one image and one point cloud in, a place out.

    Begin with `adafusion demo runs/demo`, or see `adafusion COMMAND --help`.
    """
    logging.basicConfig(
        level=logging.INFO if verbose else logging.WARNING,
        format="%(levelname)s %(name)s: %(message)s",
    )


def main() -> None:
    """Run the command line; the entry point of the console command `adafusion`."""
    try:
        _check_launch(sys.argv[1:])
        app()
    except SystemExit as ended:
        if ended.code == INTERRUPTED:  # the library says nothing
            print("adafusion: stopped by hand; see --help for how to go on", file=sys.stderr)
        raise
    except UserError as error:
        print(f"adafusion: {error}", file=sys.stderr)
        raise SystemExit(2) from None
    except (JobFailed, ModuleNotFoundError, OSError) as error:
        print(f"adafusion: {error}", file=sys.stderr)
        raise SystemExit(1) from None


def _check_launch(words: Sequence[str]) -> None:
    """UserError where torchrun started several processes of a command that they cannot share."""
    command = next((word for word in words if not word.startswith("-")), "train")
    several = "TORCHELASTIC_RUN_ID" in os.environ and os.environ.get("WORLD_SIZE") != "1"
    if several and command != "train":
        raise UserError(
            f"{command} cannot be shared by processes: start it without torchrun; "
            "`adafusion experiment --workers N` trains side by side"
        )
