"""The files of a campaign to start from: a scene for each recording of a folder, and the manifest of all."""

from __future__ import annotations

import csv
import io
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torchlc.campaigns.manifest import TASKS
from torchlc.campaigns.matching import match_files
from torchlc.campaigns.summary import plain_cell
from torchlc.cli.scaffold import check_scene, nearest_set, new_scene
from torchlc.digits import number_of
from torchlc.errors import InputError
from torchlc.files.writing import check_replaceable, write_whole
from torchlc.readers import load_recording
from torchlc.scene.reading import reading_of
from torchlc.scene.tle import passed_over, sound_sets
from torchlc.suggest import did_you_mean

MANIFEST = "manifest.csv"


@dataclass(frozen=True)
class CampaignFiles:
    """What was written: the manifest, the object of each recording in it, and why others are not."""

    manifest: Path
    matched: Mapping[Path, str]
    left_out: Mapping[Path, str]
    passed_over: Sequence[str]


def write_campaign(
    elements: Path,
    folder: Path,
    *,
    shape: str,
    station: tuple[str, float, float, float] | None,
    task: str,
    exact: bool,
    columns: str | None = None,
    force: bool,
) -> CampaignFiles:
    """Write manifest and scenes; nothing is written where a file is there already, or no recording has an object.
    ``columns`` says which column is what in every recording, and stands among the options of every object.

    The elements of a scene are those with their epoch nearest to the recording's first time.
    """
    if task not in TASKS:
        raise InputError(None, "--task", repr(task[:40]), " or ".join(TASKS), did_you_mean(task, TASKS))
    manifest = folder / MANIFEST
    texts: dict[Path, str] = {}
    matched: dict[Path, str] = {}
    left_out: dict[Path, str] = {}
    sets, wrong = sound_sets(elements)
    for match in match_files(folder, sets, [elements, manifest], reading_of(columns)):
        path = match.recording
        if not match.sets:
            left_out[path] = match.reason
            continue
        scene = path.with_name(f"{path.stem}.toml")
        if scene in texts:
            left_out[path] = (
                f"its scene would be {scene.name}, as that of another recording: give it another name"
            )
            continue
        try:
            moment: Any = load_recording(path, columns=columns).first_time
            first = float(moment.utc.jd)
            chosen = nearest_set(match.sets, first)
            texts[scene] = new_scene(chosen, shape, station=station, exact=exact)
            load_recording(path, check_scene(texts[scene], folder, scene), columns=columns)
        except InputError as error:
            texts.pop(scene, None)
            left_out[path] = f"cannot be read: {error}"
            continue
        matched[path] = chosen.label
    if not matched:
        path, reason = next(iter(left_out.items()))
        raise InputError(
            folder,
            None,
            f"none of {number_of(len(left_out), 'file')} has an object of {elements.name}; {path.name}: {reason}",
            "a catalogue number or name in the file's name, or a line # object: NAME above its header",
        )
    for path in (manifest, *texts):
        check_replaceable(path, [elements, *matched])
        if path.exists() and not force:
            raise InputError(path, None, "exists", "a new file", "--force replaces it.")
    for scene, text in texts.items():
        write_whole(scene, lambda partial, text=text: partial.write_text(text, encoding="utf-8"))
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    options = [] if columns is None else [f"--columns {shlex.quote(columns)}"]
    writer.writerow(["scene", "recording", "task", "id", *(["options"] if options else [])])
    for path in matched:
        names = (_plain_path(f"{path.stem}.toml"), _plain_path(path.name))
        writer.writerow([*names, task, plain_cell(path.stem), *options])
    write_whole(manifest, lambda partial: partial.write_text(table.getvalue(), encoding="utf-8"))
    return CampaignFiles(manifest, matched, left_out, passed_over(wrong))


def _plain_path(name: str) -> str:
    """The name of a file as a path that no spreadsheet takes for a formula."""
    return name if plain_cell(name) == name else f"./{name}"
