# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""Commands about the synthetic world: named benchmarks, contact sheets, exports."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from adafusion.cli.common import (
    WORKERS,
    Cache,
    Places,
    Profile,
    Runs,
    Seed,
    Workers,
    bar,
    cache_folder,
    say,
    split_names,
)

if TYPE_CHECKING:
    from adafusion.sim.run.conditions import Conditions
    from adafusion.sim.studio import Studio

app = typer.Typer(
    help="The synthetic world: named benchmarks, contact sheets, exports.", no_args_is_help=True
)


@app.command("list")
def list_benchmarks(
    check: Annotated[
        bool,
        typer.Option(
            "--check", help="Build each world and compare it, and what is rendered; takes a minute."
        ),
    ] = False,
    cache: Cache = None,
) -> None:
    """List the named worlds, what they are for, and which are rendered already.

    \b
    Example: adafusion world list --check
    """
    from adafusion.sim.benchmarks import (
        BENCHMARKS,
        benchmark_folder,
        found_hashes,
        open_benchmark,
    )
    from adafusion.types import UserError

    wrong = []
    for benchmark, known in BENCHMARKS.items():
        print(f"{benchmark}: {known.words}\n  runs {' '.join(known.runs)}")
        for name, part in known.parts.items():
            folder = benchmark_folder(f"{benchmark}/{name}", cache_folder(cache))
            state = str(folder) if folder.exists() else "not rendered yet"
            line = f"  {benchmark}/{name}: world {part.seed}, geometry {part.geometry}, {state}"
            if check:
                matches = found_hashes(f"{benchmark}/{name}") == (part.geometry, part.settings)
                line += ", this installation builds it" if matches else ", MISMATCH"
                wrong += [] if matches else [f"{benchmark}/{name}"]
                if matches and folder.exists():
                    open_benchmark(f"{benchmark}/{name}", cache_folder(cache))  # or says why not
            print(line)
    if wrong:
        raise UserError(
            f"this installation builds other worlds under the names {', '.join(wrong)}: numbers "
            "measured on them would not compare; install a release without local changes"
        )


@app.command()
def render(
    name: Annotated[str, typer.Argument(help="world-v1-small, or a part: world-v1-small/test.")],
    workers: Workers = WORKERS,
    cache: Cache = None,
) -> None:
    """Render a named world into the cache; a killed rendering goes on where it was.

    Every command that takes a dataset also takes the name and renders what is missing.

    \b
    Example: adafusion world render world-v1-small
    """
    from adafusion.sim.benchmarks import names, open_benchmark
    from adafusion.types import UserError

    parts = [known for known in names() if known == name or known.partition("/")[0] == name]
    if not parts:
        raise UserError(f"unknown benchmark {name!r}; choose from {', '.join(names())}")
    for part in parts:
        dataset = open_benchmark(part, cache_folder(cache), workers=workers, progress=bar)
        print(f"{dataset.root}: {part}, {len(dataset.frames)} frames (synthetic)")


@app.command()
def sheet(
    out: Annotated[Path, typer.Argument(help="A .png or .html file.")],
    seed: Seed = 1,
    profile: Profile = "small",
    conditions: Annotated[
        str, typer.Option(help="Columns: presets, by comma.")
    ] = "day,overcast,dusk,night,fog,rain,snow,glare,winter,autumn",
    places: Annotated[
        int,
        typer.Option(
            help="Rows: about so many places, and one of each kind of zone at least.", min=1
        ),
    ] = 14,
    from_above: Annotated[
        bool, typer.Option("--from-above", help="Draw each cloud from above as well.")
    ] = False,
) -> None:
    """Draw places under conditions on one page: image, and range image of the LiDAR below it.

    Every column of a row is seen from the same spot with the same cars: only the condition differs.

    \b
    Example: adafusion world sheet runs/sheet.html --seed 3 --conditions day,night,snow
    """
    from adafusion.files import make_folder
    from adafusion.sim.sheet import cell_of, check_suffix, write_sheet
    from adafusion.sim.studio import Studio, make_job

    check_suffix(out)  # said before the work, as is what cannot be written
    make_folder(out.parent)
    runs = {name: _with_the_same_streets(name) for name in split_names(conditions)}
    studio = Studio(make_job(seed, runs, profile))
    shown = _spread_over_zones(studio, next(iter(runs)), places)
    # condition by condition: the scene of a run is kept
    todo = [(run, k) for run in runs for k in shown]
    cells = {
        (run, k): cell_of(studio.observe(run, k)[1], studio.lidar, from_above=from_above)
        for run, k in bar(todo, desc="looking")
    }
    zone = studio.drive(next(iter(runs))).zone
    write_sheet(
        out,
        [[cells[run, k] for run in runs] for k in shown],
        [f"{zone[k]} {k}" for k in shown],
        list(runs),
        title=f"World {seed}, profile {profile}",
    )
    print(out)


@app.command()
def export(
    kind: Annotated[str, typer.Argument(help="nclt, robotcar or pointnetvlad.")],
    out: Annotated[Path, typer.Argument(help="Folder to write; must not exist.")],
    seed: Seed = 1,
    runs: Runs = "day,night",
    profile: Profile = "small",
    places: Places = None,
) -> None:
    """Write a synthetic drive in the raw layout of a real dataset; its manifest says synthetic.

    What reads the real files reads these: to try a reader, or a pipeline built for the real data.

    \b
    Example: adafusion world export nclt data/nclt-like --seed 3 --runs day,night --places 50
    """
    from adafusion.sim.exports import export as run

    run(kind, out, seed=seed, runs=split_names(runs), profile=profile, places=places, progress=bar)
    say("SYNTHETIC: the manifest says so, and so must whoever passes the files on")
    spacing = {"nclt": " --every-m 0", "robotcar": " --every-m 5"}.get(kind, "")  # of its pictures
    say(f"a dataset again: adafusion prepare {kind} {out} {out}-prepared{spacing}")
    print(out)


def _with_the_same_streets(name: str) -> Conditions:
    """A preset driven the same way, with the same things in the streets, as every other one."""
    from dataclasses import replace

    from adafusion.sim.run.conditions import preset, with_seeds

    seen = with_seeds(preset(name), 1)
    return replace(seen, parked_density=0.35, traffic_density=0.25, people_density=0.15)


def _spread_over_zones(studio: Studio, run: str, places: int) -> list[int]:
    """Frames of a run, about `places` of them and as many of each kind of zone, one at least."""
    zone = studio.drive(run).zone
    by_kind = {kind: [k for k, z in enumerate(zone) if z == kind] for kind in sorted(set(zone))}
    share = max(places // len(by_kind), 1)
    chosen = []
    for rows in by_kind.values():
        step = max(len(rows) // (share + 1), 1)
        chosen += rows[step::step][:share] or rows[:1]
    return chosen
