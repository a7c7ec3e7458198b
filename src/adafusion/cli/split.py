# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
"""The command that says which part of a dataset teaches, which chooses and which judges."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from adafusion.cli.common import say
from adafusion.types import UserError

if TYPE_CHECKING:
    from adafusion.datasets import Dataset
    from adafusion.datasets.splits import Published, SplitFile
    from adafusion.evaluation.split_counts import SplitCounts

Plain = dict[str, list[list[float]]]

BUFFER_M = 25.0  # true matches reach 20 or 25 m
TEST_SHARE, VALIDATION_SHARE = 0.3, 0.1
PICTURES = (".png", ".svg", ".pdf")


def split(
    dataset: Annotated[Path, typer.Argument(help="Folder of a prepared or simulated dataset.")],
    name: Annotated[
        str | None,
        typer.Argument(help="A split that comes with the package, or a YAML file of one."),
    ] = None,
    check: Annotated[
        bool,
        typer.Option(
            "--check", help="Write nothing; alone: count under every split of this world."
        ),
    ] = False,
    auto: Annotated[
        bool, typer.Option("--auto", help="Cut test and validation blocks out of own data.")
    ] = False,
    box: Annotated[
        list[str] | None,
        typer.Option(help="Box by hand, test=XMIN,YMIN,XMAX,YMAX or validation=...; repeatable."),
    ] = None,
    test: Annotated[
        float | None, typer.Option(help="--auto: share of all frames to test on; default 0.3.")
    ] = None,
    validation: Annotated[
        float | None,
        typer.Option(
            help="Share of all frames to cut out of training for choosing checkpoints; default "
            "0.1 with --auto, else none."
        ),
    ] = None,
    buffer_m: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            help="Width of the strip around boxes that nobody uses; default: the named split's "
            "own, else 25.",
        ),
    ] = None,
    block_m: Annotated[float, typer.Option(help="Side of the blocks that are cut.")] = 100.0,
    seed: Annotated[int, typer.Option(help="Which blocks: another seed, others.", min=0)] = 0,
    plot: Annotated[
        Path | None, typer.Option(help="Draw all runs and the boxes: a .png, .svg or .pdf.")
    ] = None,
) -> None:
    """Write the regions of a dataset: a named split, boxes by hand, or blocks cut by themselves.

    Prints how many frames, pairs and queries there are then, beside those of the paper where the
    split names them. Without NAME, --auto and --box it shows the regions that are there. Only
    dataset.yaml changes; preprocessed frames in the cache are made anew after that.

    \b
    Example: adafusion split data/robotcar --check
    Example: adafusion split data/robotcar robotcar-boxes --validation 0.1 --plot boxes.png
    Example: adafusion split data/mine --auto --test 0.3 --validation 0.1 --seed 0
    Example: adafusion split data/mine --box test=0,0,200,150 --buffer-m 30
    """
    import yaml

    from adafusion.datasets import open_dataset
    from adafusion.datasets.splits import GUARD, TEST, TRAIN, VALIDATION
    from adafusion.datasets.writer import write_regions
    from adafusion.evaluation.split_counts import count_split

    ways = [way for way, given in (("NAME", name), ("--auto", auto), ("--box", box)) if given]
    if len(ways) > 1:
        raise UserError(f"{' and '.join(ways)} both make regions: give one of them")
    if test is not None and not auto:
        raise UserError("--test is the share that --auto cuts: give --auto, or leave it out")
    if not ways and (validation is not None or buffer_m is not None):
        raise UserError("--validation and --buffer-m need a split: give NAME, --auto or --box")
    if plot is not None and plot.suffix.lower() not in PICTURES:
        raise UserError(f"--plot {plot}: give a file that ends in {', '.join(PICTURES)}")

    data = open_dataset(dataset)
    regions, about = data.info.regions, data.info.conventions.get("regions", "")
    published: Published | None = None
    guard_m = BUFFER_M if buffer_m is None else buffer_m
    cuts: dict[str, float] = {}
    if name is not None:
        regions, about, published = _named(data, name, buffer_m)
    elif box:
        regions, about = _by_hand(box, guard_m)
    elif auto:
        regions, about = {}, "cut"
        cuts[TEST] = TEST_SHARE if test is None else test
        validation = VALIDATION_SHARE if validation is None else validation
    if validation:
        cuts[VALIDATION] = validation
    for region, share in cuts.items():
        regions = _cut(data, region, share, regions, block_m, guard_m, seed)
    if cuts:
        shares = ", ".join(f"{region} {share:g}" for region, share in cuts.items())
        about += f": {shares} in blocks of {block_m:g} m, guard {guard_m:g} m, seed {seed}"

    print(_headline(data))
    fitting = _fitting(data) if check and not ways else []
    if fitting:
        _check_all(data, fitting)
    else:
        counts = count_split(data.frames, data.positions_m, regions)
        if ways and not counts.frames[TEST]:
            raise UserError(f"no frame of {dataset} lies in the test boxes: choose others")
        print(_table(about or "regions of dataset.yaml", counts, published))
        for empty in (TRAIN, *regions):
            if not counts.frames[empty] and empty != GUARD:
                say(f"warning: no frame lies in the {empty} region")
    if plot is not None:
        _draw(data, regions, f"{data.root.name}: {about}" if about else data.root.name, plot)
    if ways and not check:
        write_regions(data, regions, about)
        before = yaml.safe_dump(
            data.info.regions, default_flow_style=True, sort_keys=False, width=10**6
        ).strip()
        say(f"{dataset / 'dataset.yaml'}: regions written; before: {before}")


def _named(data: Dataset, name: str, buffer_m: float | None) -> tuple[Plain, str, Published | None]:
    from adafusion.datasets.splits import load_split

    chosen = load_split(name)
    if not chosen.fits(data.world):
        raise UserError(
            f"split {chosen.name} is for coordinates of {' or '.join(chosen.worlds)}, and those of "
            f"{data.root} are of {data.world}: choose another, or give a file with other `worlds`"
        )
    guard_m = chosen.guard_m if buffer_m is None else buffer_m
    about = chosen.name if guard_m == chosen.guard_m else f"{chosen.name}, guard {guard_m:g} m"
    try:
        return chosen.boxes(guard_m), about, chosen.published
    except ValueError as error:
        raise UserError(f"split {chosen.name}: {error}: give another --buffer-m") from error


def _cut(
    data: Dataset,
    region: str,
    share: float,
    regions: Plain,
    block_m: float,
    guard_m: float,
    seed: int,
) -> Plain:
    """Cut one more region, and say from how many blocks."""
    import numpy as np

    from adafusion.datasets.blocks import cut_region
    from adafusion.datasets.splits import VALIDATION

    # one generator a region: validation is drawn alike whatever the test was drawn from
    rng = np.random.default_rng([seed, *region.encode()])
    xy, runs = data.positions_m[:, :2], [frame.run for frame in data.frames]
    try:
        regions, chosen = cut_region(
            region, share, regions, xy, runs, rng, block_m=block_m, buffer_m=guard_m
        )
    except UserError as error:
        without = "; or go without: --validation 0" if region == VALIDATION else ""
        raise UserError(f"{region}: {error}{without}") from error
    say(
        f"{region}: {chosen.blocks} of {chosen.eligible} blocks that two runs or more visit and no "
        f"other region is near ({chosen.visited} are visited at all)"
    )
    return regions


def _by_hand(texts: Sequence[str], guard_m: float) -> tuple[Plain, str]:
    from adafusion.datasets.splits import TEST, VALIDATION, check_boxes, with_guard

    regions: Plain = {}
    for text in texts:
        name, _, edges = text.partition("=")
        try:
            box = [float(edge) for edge in edges.split(",")]
            check_boxes({name: [box]})
        except ValueError:
            box = []
        if name not in (TEST, VALIDATION) or not box:
            raise UserError(
                f"--box {text}: write test=XMIN,YMIN,XMAX,YMAX or validation=..., in metres; XMIN "
                "must be below XMAX, YMIN below YMAX"
            )
        regions.setdefault(name, []).append(box)
    try:
        return with_guard(regions, guard_m), f"boxes by hand, guard {guard_m:g} m"
    except ValueError as error:
        raise UserError(f"{error}: give other boxes, or another --buffer-m") from error


def _fitting(data: Dataset) -> list[SplitFile]:
    """The splits that come with the package and are for the world of these data."""
    from adafusion.datasets.splits import named_splits

    fitting = [known for known in named_splits().values() if known.fits(data.world)]
    if not fitting:
        say(
            f"no split that comes with the package is for {data.world}: these are the dataset's "
            "own regions; cut others by --auto or --box"
        )
    return fitting


def _check_all(data: Dataset, fitting: Sequence[SplitFile]) -> None:
    from adafusion.evaluation.split_counts import count_split

    distances = {}
    for known in fitting:
        counts = count_split(data.frames, data.positions_m, known.boxes())
        print(
            _table(f"{known.name}: {known.words}\n  From: {known.source}.", counts, known.published)
        )
        if known.guess:
            print(f"  A guess: {known.guess}.")
        if known.published is not None:
            distances[known.name] = counts.distance(known.published)
    if distances:
        best = min(distances, key=lambda known: distances[known])
        print(
            f"\nNearest to its paper's train and test frames: {best} ({distances[best]:.1%} off "
            "on the mean)"
        )


def _headline(data: Dataset) -> str:
    import numpy as np

    steps = [
        np.hypot(*(np.subtract(after.position_m, before.position_m)[:2]))
        for before, after in zip(data.frames[:-1], data.frames[1:], strict=True)
        if before.run == after.run
    ]
    spacing = f", {np.median(steps):.1f} m apart on the median" if steps else ""
    return (
        f"{data.root}: {len(data.frames):,} frames in {len(data.runs)} runs{spacing}; world "
        f"{data.world}"
    )


def _table(title: str, counts: SplitCounts, published: Published | None) -> str:
    from adafusion.evaluation.protocols import PROTOCOLS
    from adafusion.evaluation.split_counts import TRUE_M, WRONG_M, possible_pairs

    radius_m = PROTOCOLS["cross-run"].radius_m
    rows: list[tuple[str, int, str]] = [
        (f"{region} frames", number, f"{region}_frames") for region, number in counts.frames.items()
    ]
    rows += [
        (f"true pairs, train, at most {TRUE_M:g} m", counts.true_pairs, "true_pairs"),
        (f"wrong pairs, train, at least {WRONG_M:g} m", counts.wrong_pairs, "wrong_pairs"),
        ("queries, cross-run", counts.queries, "queries"),
        (f"of these with a match in {radius_m:g} m", counts.answerable, ""),
    ]
    head = f"  {'':34}{'here':>12}" + (f"{'paper':>12}{'off by':>9}" if published else "")
    lines = ["", title, head]
    off = counts.differences(published) if published else {}
    for words, number, key in rows:
        said = f"{getattr(published, key):12,}{off[key]:+9.1%}" if key in off else ""
        lines.append(f"  {words:34}{number:12,}{said}")
    nearest = f"{counts.nearest_m:10.1f} m" if counts.nearest_m < float("inf") else f"{'none':>12}"
    lines.append(f"  {'nearest train to test frame':34}{nearest}")
    if published:
        most = possible_pairs(published.train_frames)
        lines.append(f"  Paper: {published.source}.")
        if published.wrong_pairs > most:
            lines.append(
                f"  It cannot have {published.wrong_pairs:,} wrong pairs: "
                f"{published.train_frames:,} frames make {most:,} pairs in all."
            )
    return "\n".join(lines)


def _draw(data: Dataset, regions: Plain, title: str, out: Path) -> None:
    from adafusion.files import atomic_path
    from adafusion.report import plots

    ways = {
        run: data.positions_m[[frame.run == run for frame in data.frames], :2] for run in data.runs
    }
    figure = plots.region_map(ways, regions, title=title)
    try:
        with atomic_path(out) as temporary:
            figure.savefig(temporary, dpi=160, facecolor="white")
    except OSError as error:
        raise UserError(f"--plot {out} cannot be written ({error.strerror})") from error
    say(f"{out}: drawn")
