# SPDX-FileCopyrightText: 2026 The adafusion authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest

from adafusion.datasets.native import DatasetInfo
from adafusion.datasets.recording import SKIPPED_FILE, Recording, Shot, write_recording
from adafusion.datasets.sensor_files import read_cloud
from adafusion.types import Frame, UserError

INFO = DatasetInfo(name="toy", version="1", source="a test", licence="CC0-1.0", synthetic=True)


def grey(level: int) -> np.ndarray:
    return np.full((4, 6, 3), level, np.uint8)


def encoded(level: int) -> bytes:
    return cv2.imencode(".jpg", grey(level))[1].tobytes()


def line(n: int, log: str | None = None) -> np.ndarray:
    if log is not None:
        with Path(log).open("a") as file:
            file.write(f"{n}\n")
    return np.arange(3 * n, dtype=np.float64).reshape(n, 3)


def damaged(name: str) -> np.ndarray:
    raise UserError(f"{name} is cut short: leave it out")


def frame(k: int, run: str = "a") -> Frame:
    return Frame(run=run, timestamp_us=1000 * k, position_m=(float(k), 0.0, 0.0))


def shot(k: int, **parts: object) -> Shot:
    return Shot(**{"frame": frame(k), "image": partial(grey, k), "cloud": partial(line, k)} | parts)


@pytest.mark.parametrize("workers", [1, 2])
def test_it_writes_what_the_functions_decode(tmp_path: Path, workers: int) -> None:
    shots = [
        Shot(
            frame=frame(k),
            image=partial(np.full, (4, 6, 3), k, np.uint8),
            cloud=partial(np.full, (k, 3), 0.5),
        )
        for k in (1, 2, 3)
    ]
    recording = Recording(info=INFO, shots=shots, total=3)
    written = write_recording(recording, tmp_path / "out", workers=workers)
    assert written.skipped == ()
    assert written.resumed == 0
    assert [f.key for f in written.dataset.frames] == ["a/1000", "a/2000", "a/3000"]
    seen = written.dataset.load(written.dataset.frames[1])
    assert np.array_equal(seen.image, grey(2))
    assert np.array_equal(seen.points_body, np.full((2, 3), 0.5))
    assert seen.points_body.dtype == np.float32
    assert written.frames_per_second > 0
    assert 0 <= written.decode_share <= 1


def test_it_keeps_encoded_images_byte_for_byte(tmp_path: Path) -> None:
    one = shot(1, image=partial(encoded, 9), image_suffix=".jpg")
    dataset = write_recording(Recording(info=INFO, shots=[one]), tmp_path / "out").dataset
    assert (dataset.root / dataset.frames[0].image).read_bytes() == encoded(9)


def test_it_writes_frames_of_one_sensor(tmp_path: Path) -> None:
    shots = [shot(1, image=None), shot(2, cloud=None)]
    dataset = write_recording(Recording(info=INFO, shots=shots), tmp_path / "out").dataset
    assert [(f.image, f.cloud) for f in dataset.frames] == [
        (None, "a/clouds/1000.npy"),
        ("a/images/2000.png", None),
    ]


def test_it_stops_at_the_first_damaged_frame_and_keeps_what_is_whole(tmp_path: Path) -> None:
    shots = [shot(1), shot(2, cloud=partial(damaged, "2.bin")), shot(3)]
    with pytest.raises(UserError, match=r"2\.bin is cut short"):
        write_recording(Recording(info=INFO, shots=shots), tmp_path / "out")
    assert not (tmp_path / "out").exists()
    mended = Recording(info=INFO, shots=[shot(1), shot(2), shot(3)])
    written = write_recording(mended, tmp_path / "out")
    assert written.resumed == 1
    assert len(written.dataset.frames) == 3


@pytest.mark.parametrize("workers", [1, 2])
def test_it_leaves_damaged_frames_out_where_it_is_told_to(tmp_path: Path, workers: int) -> None:
    image, missing = partial(np.zeros, (4, 6, 3), np.uint8), tmp_path / "2.bin"
    shots = [
        shot(1, image=image, cloud=partial(np.ones, (5, 3))),
        shot(2, image=image, cloud=partial(read_cloud, missing)),
        shot(3, image=image, cloud=partial(np.ones, (0, 3))),
    ]
    written = write_recording(
        Recording(info=INFO, shots=shots), tmp_path / "out", skip_bad=True, workers=workers
    )
    assert [one.key for one in written.skipped] == ["a/2000", "a/3000"]
    assert [f.key for f in written.dataset.frames] == ["a/1000"]
    told = (tmp_path / "out" / SKIPPED_FILE).read_text()
    assert f"a/2000: {missing} is missing" in told
    assert "a/3000 holds no points" in told
    assert not (tmp_path / "out" / "a" / "images" / "2000.png").exists()


def test_it_keeps_what_came_before_a_stream_broke_off(tmp_path: Path) -> None:
    def stream() -> Iterator[Shot]:
        yield shot(1)
        yield shot(2)
        raise UserError("drive.bag ends within a chunk at byte 4096: reindex it")

    written = write_recording(Recording(info=INFO, shots=stream()), tmp_path / "a", skip_bad=True)
    assert [one.key for one in written.skipped] == [""]
    assert len(written.dataset.frames) == 2
    with pytest.raises(UserError, match="byte 4096"):
        write_recording(Recording(info=INFO, shots=stream()), tmp_path / "b")


class Streams:
    """Shots, and between them faults, after which it goes on."""

    def __init__(self, *coming: Shot | UserError) -> None:
        self.coming = iter(coming)

    def __iter__(self) -> Streams:
        return self

    def __next__(self) -> Shot:
        one = next(self.coming)
        if isinstance(one, UserError):
            raise one
        return one


@pytest.mark.parametrize("workers", [1, 2])
def test_it_goes_on_with_what_comes_after_a_fault(tmp_path: Path, workers: int) -> None:
    one, two = (shot(k, image=None, cloud=partial(np.ones, (5, 3))) for k in (1, 2))
    fault = UserError("one.bag ends within a chunk: reindex it")
    recording = Recording(info=INFO, shots=Streams(one, fault, two))
    written = write_recording(recording, tmp_path / "out", skip_bad=True, workers=workers)
    assert [one.reason for one in written.skipped] == [str(fault)]
    assert [f.key for f in written.dataset.frames] == ["a/1000", "a/2000"]


def test_it_refuses_two_frames_of_one_time(tmp_path: Path) -> None:
    shots = [shot(1), shot(1)]
    with pytest.raises(UserError, match="two frames of run a have the time 1000"):
        write_recording(Recording(info=INFO, shots=shots), tmp_path / "out")
    written = write_recording(Recording(info=INFO, shots=shots), tmp_path / "out", skip_bad=True)
    assert len(written.dataset.frames) == 1


def test_it_decodes_nothing_twice_when_it_resumes(tmp_path: Path) -> None:
    log = str(tmp_path / "log")

    def shots(last: object) -> list[Shot]:
        return [
            shot(1, cloud=partial(line, 1, log)),
            shot(2, cloud=partial(line, 2, log)),
            shot(3, cloud=last),
        ]

    with pytest.raises(UserError):
        write_recording(Recording(info=INFO, shots=shots(partial(damaged, "x"))), tmp_path / "out")
    written = write_recording(
        Recording(info=INFO, shots=shots(partial(line, 3, log))), tmp_path / "out"
    )
    assert written.resumed == 2
    assert Path(log).read_text().split() == ["1", "2", "3"]


def test_it_refuses_a_run_that_cannot_name_a_folder(tmp_path: Path) -> None:
    shots = [shot(1, frame=frame(1, run="../elsewhere"))]
    with pytest.raises(UserError, match="cannot name a folder"):
        write_recording(Recording(info=INFO, shots=shots), tmp_path / "out")


@pytest.mark.parametrize("name", ["a\udcff", "a\nb", "skipped.txt", "x" * 300])
def test_it_refuses_such_a_run_before_anything_of_it_is_decoded(tmp_path: Path, name: str) -> None:
    log = tmp_path / "log"
    shots = [shot(1, frame=frame(1, run=name), cloud=partial(line, 1, str(log)))]
    with pytest.raises(UserError, match="cannot name a folder"):
        write_recording(Recording(info=INFO, shots=shots), tmp_path / "out", skip_bad=True)
    assert not log.exists()


def test_a_dataset_lists_what_it_lacks_from_its_first_moment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def power_cut(folder: Path, out: Path) -> None:
        rename(folder, out)
        raise RuntimeError("power cut")

    rename = Path.rename
    monkeypatch.setattr(Path, "rename", power_cut)
    shots = [shot(1), shot(2, cloud=partial(damaged, "2.bin"))]
    with pytest.raises(RuntimeError, match="power cut"):
        write_recording(Recording(info=INFO, shots=shots), tmp_path / "out", skip_bad=True)
    assert "2.bin is cut short" in (tmp_path / "out" / SKIPPED_FILE).read_text()


def test_a_list_of_an_earlier_job_does_not_stay(tmp_path: Path) -> None:
    shots = [shot(1), shot(2, cloud=partial(damaged, "2.bin"))]
    write_recording(Recording(info=INFO, shots=shots), tmp_path / "out", skip_bad=True)
    (tmp_path / "out").rename(tmp_path / "out.partial")  # only the name was not taken
    write_recording(Recording(info=INFO, shots=[shot(1), shot(2)]), tmp_path / "out")
    assert not (tmp_path / "out" / SKIPPED_FILE).exists()


def test_it_says_why_no_frame_is_left(tmp_path: Path) -> None:
    shots = [shot(k, cloud=partial(damaged, f"{k}.bin")) for k in range(1, 9)]
    with pytest.raises(
        UserError, match=r"no frame is left, 8 faults .*: 1\.bin is cut short.*2\.bin is"
    ) as told:
        write_recording(Recording(info=INFO, shots=shots), tmp_path / "out", skip_bad=True)
    assert "8.bin" not in str(told.value)
    assert not (tmp_path / "out").exists()
