"""Orbits from files: element sets of many epochs, and Orbit Ephemeris Messages against Kepler, SGP4 and astropy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from astropy.time import Time, TimeDelta
from sgp4.api import WGS72, Satrec

import torchlc
from tests.good_input import SCENE, TLE
from torchlc.errors import InputError
from torchlc.geometry.orbit import make_track
from torchlc.geometry.orbit.elements import ElementSet
from torchlc.readers import load_recording
from torchlc.scene import Scene, load_scene
from torchlc.scene.tle import Elements, nearest, read_catalogue, read_elements, sets_of_object

CASES = Path(__file__).parents[2] / "shared" / "cases" / "tle"

ISS = (
    "1 25544U 98067A   20045.18587073  .00000950  00000-0  25302-4 0  9990",
    "2 25544  51.6443 242.0161 0004885 264.6060 207.3845 15.49165514212791",
)
GEO_1 = "1 00001U 16037A   20284.07341138 -.00000354  00000-0  00000+0 0  9993"
GEO_2 = "2 00001   1.7237  67.2351 0007471   0.1818  88.7233  1.00273124 15966"
LATER = GEO_1.replace("20284", "20294").replace("9993", "9994")
HEADER = (
    "CCSDS_OEM_VERS = 2.0\nCREATION_DATE = 2020-01-01T00:00:00\nORIGINATOR = TEST\nCOMMENT made by a test\n"
)
STATION = SCENE[SCENE.index("[[stations]]") : SCENE.index("[attitude]")]


def scene_with(folder: Path, orbit: str) -> Scene:
    path = folder / "scene.toml"
    path.write_text(SCENE.replace(TLE, orbit + "\n\n"))
    return load_scene(path)


def rows(folder: Path, scene: Scene, moments: Time):
    text = "time,mag\n" + "".join(f"{one},9\n" for one in moments.utc.isot)
    (folder / "recording.csv").write_text(text)
    return load_recording(folder / "recording.csv", scene)


def places(scene: Scene, recording, offset: float = 0.0) -> np.ndarray:
    """Geocentric positions (T, 3), km, ``offset`` s after the stamps."""
    position = make_track(scene, recording).at(0.0, offset, 0.0).position
    assert position is not None
    return position.numpy()


def message(times: Time, position: np.ndarray, velocity: np.ndarray, frame: str, system: str = "UTC") -> str:
    scale = {"GPS": "tai"}.get(system, system.lower())
    said = getattr(times, scale) - TimeDelta(19.0 if system == "GPS" else 0.0, format="sec")
    said.precision = 6
    meta = f"OBJECT_NAME = X\nOBJECT_ID = 2020-001A\nCENTER_NAME = EARTH\nREF_FRAME = {frame}\nTIME_SYSTEM = {system}"
    head = (
        f"{HEADER}META_START\n{meta}\nSTART_TIME = {said.isot[0]}\nSTOP_TIME = {said.isot[-1]}\nMETA_STOP\n"
    )
    lines = (
        f"{one} " + " ".join(f"{value:.9f}" for value in (*r, *v))
        for one, r, v in zip(said.isot, position, velocity, strict=True)
    )
    return head + "\n".join(lines) + "\n"


def sgp4_states(lines: tuple[str, str], times: Time) -> tuple[np.ndarray, np.ndarray]:
    codes, position, velocity = Satrec.twoline2rv(*lines, WGS72).sgp4_array(times.utc.jd1, times.utc.jd2)
    assert not codes.any()
    return position, velocity


def spaced(start: str, count: int, step_s: float) -> Time:
    return Time(start, scale="utc") + TimeDelta(np.arange(count) * step_s, format="sec")


class TestElementFiles:
    def test_each_night_takes_the_nearest_set(self, tmp_path: Path):
        (tmp_path / "many.txt").write_text(f"0 SAT\n{GEO_1}\n{GEO_2}\n0 SAT\n{LATER}\n{GEO_2}\n")
        many = scene_with(tmp_path, 'tle_file = "many.txt"')
        nights = Time(["2020-10-12T14:00", "2020-10-12T20:00", "2020-10-20T15:00", "2020-10-20T16:00"])
        recording = rows(tmp_path, many, nights)
        for offset in (0.0, 40.0, -3600.0):
            found = places(many, recording, offset)
            for part, line in ((slice(0, 2), GEO_1), (slice(2, 4), LATER)):
                alone = scene_with(tmp_path, f'tle = ["{line}", "{GEO_2}"]')
                np.testing.assert_allclose(found[part], places(alone, recording, offset)[part], atol=1e-4)
        warning = make_track(many, recording).warnings[0]
        assert (
            "many.txt: of 2 element sets the nearest to each night is taken: 2020-10-10T01:45, 2020-10-20"
            in warning
        )

    def test_simulated_and_written_back(self, tmp_path: Path):
        (tmp_path / "many.txt").write_text(f"{GEO_1}\n{GEO_2}\n")
        scene = scene_with(tmp_path, 'tle_file = "many.txt"')
        again = Scene.from_toml(scene.to_toml(), tmp_path)
        assert again.model_dump() == scene.model_dump()
        curve = torchlc.simulate(scene, start="2020-10-17T15:00", hours=1, cadence=600)
        plain = torchlc.simulate(Scene.from_toml(SCENE), start="2020-10-17T15:00", hours=1, cadence=600)
        np.testing.assert_array_equal(curve.mag, plain.mag)

    @pytest.mark.parametrize(
        ("content", "message"),
        [
            ("", "no two-line elements"),
            (f"{GEO_1}\n{GEO_2}\n{ISS[0]}\n{ISS[1]}\n", r"elements of 2 objects \(1, 25544\)"),
            (f"x\n{GEO_1}\n{GEO_2.replace('67.2351', '67.2352')}\n", "line 3: checksum"),
            (None, "orbit.tle_file: no file 'many.txt'"),
        ],
    )
    def test_what_is_wrong_is_named(self, tmp_path: Path, content: str | None, message: str):
        if content is not None:
            (tmp_path / "many.txt").write_text(content)
        with pytest.raises(InputError, match=message):
            scene = scene_with(tmp_path, 'tle_file = "many.txt"')
            make_track(scene, rows(tmp_path, scene, Time(["2020-10-17T15:00:00"])))


def with_checksum(line: str) -> str:
    """The line with its check digit: digits count themselves, minus signs 1 (Hoots & Roehrich 1980)."""
    return line[:68] + str(sum(int(c) if c in "0123456789" else c == "-" for c in line[:68]) % 10)


def changed(line: str, old: str, new: str) -> str:
    assert old in line and len(old) == len(new)
    return with_checksum(line.replace(old, new, 1))


class TestElementLines:
    """What catalogues write, and what no orbit has."""

    def read(self, folder: Path, content: str | bytes) -> list[Elements]:
        (folder / "e.txt").write_bytes(content if isinstance(content, bytes) else content.encode())
        return read_elements(folder / "e.txt")

    @pytest.mark.parametrize(
        "content",
        [
            "\ufeff{0}\n{1}\n{2}\n{1}\n",
            "\ufeff0 A SAT\n{0}\n{1}\n\ufeff{2}\n{1}\n",
            "{0}\r\n{1}\r\n{2}\r\n{1}\r\n",
            "{0}\r{1}\r{2}\r{1}",
            "# from a catalogue\n\n{0}  \t\n\n{1}   \n  {2}\n\t{1}\n",
            "1 NAME OF ONE\n{0}\n{1}\n2 NAME\n{2}\n{1}\n",
            "{0} 1 more\n{1} 2 more\n{2}\n{1}\n",
        ],
        ids=["BOM", "two BOMs", "Windows", "old Mac", "blanks", "names with numbers", "remarks behind"],
    )
    def test_no_set_is_lost(self, tmp_path: Path, content: str):
        found = self.read(tmp_path, content.format(GEO_1, GEO_2, LATER))
        assert [one.lines for one in found] == [(GEO_1, GEO_2), (LATER, GEO_2)]
        assert [round(one.epoch, 5) for one in found] == [2459132.57341, 2459142.57341]

    def test_names_above(self, tmp_path: Path):
        found = self.read(
            tmp_path, f"0 FIRST\n{GEO_1}\n{GEO_2}\nSECOND B\n{LATER}\n{GEO_2}\n{GEO_1}\n{GEO_2}\n"
        )
        assert [one.name for one in found] == ["FIRST", "SECOND B", None]

    @pytest.mark.parametrize(
        ("line", "old", "new"),
        [
            (1, " -.00000354", " 0.00000354"),
            (1, " -.00000354", " +.00000354"),
            (1, " 00000-0 ", " 00000+0 "),
            (1, " 00000+0 ", "000000+0 "),
            (1, " 00000+0 ", " 00000 0 "),
            (1, " 00000+0 ", " 0000000 "),
            (1, "00001U", "00001u"),
            (1, "00001U", "00001 "),
            (1, "16037A  ", "        "),
            (1, " 999", "   0"),
            (2, "  67.2351", " 067.2351"),
            (2, "0007471", "  07471"),
        ],
    )
    def test_variants_that_sgp4_reads_alike(self, tmp_path: Path, line: int, old: str, new: str):
        """The library's own reader finds the same numbers in the lines that are let through."""
        lines = [GEO_1, GEO_2]
        lines[line - 1] = changed(lines[line - 1], old, new)
        (one,) = self.read(tmp_path, "\n".join(lines))
        ours, plain = (Satrec.twoline2rv(*two, WGS72) for two in (one.lines, (GEO_1, GEO_2)))
        for name in ("jdsatepoch", "jdsatepochF", "bstar", "nddot", "ecco", "inclo", "nodeo", "argpo", "mo"):
            assert getattr(ours, name) == getattr(plain, name)

    @pytest.mark.parametrize("number", ["A0001", "Z9999", "    1"])
    def test_catalogue_numbers(self, tmp_path: Path, number: str):
        lines = [changed(line, " 00001", f" {number}") for line in (GEO_1, GEO_2)]
        if " " in number:
            with pytest.raises(
                InputError, match=r"line 1: column 4: ' ' in '1     1U 16037A   20284.*with its zeros"
            ):
                self.read(tmp_path, "\n".join(lines))
        else:
            assert len(self.read(tmp_path, "\n".join(lines))) == 1

    @pytest.mark.parametrize(
        ("field", "number"),
        [("A0000", 100000), ("E8493", 148493), ("J2931", 182931), ("P4018", 234018), ("Z9999", 339999)],
    )
    def test_a_letter_stands_for_two_digits(self, tmp_path: Path, field: str, number: int):
        """As the SGP4 package reads Alpha-5; an object is found by either writing, and its orbit is that of the digits."""
        lines = [changed(line, " 00001", f" {field}") for line in (GEO_1, GEO_2)]
        assert Satrec.twoline2rv(*lines).satnum == number
        (elements,) = self.read(tmp_path, "\n".join(lines))
        assert elements.whole_number == str(number)
        path = tmp_path / "two.txt"
        path.write_text("\n".join([*lines, GEO_1, GEO_2]))
        catalogue = read_catalogue(path)
        for written in (field, field.lower(), str(number)):
            (chosen,) = sets_of_object(path, catalogue, written)
            assert chosen.lines == elements.lines

    @pytest.mark.parametrize(
        ("line", "old", "new", "message"),
        [
            (1, " 00001U", " O0001U", "column 3: 'O' .*a letter other than I and O"),
            (1, " 00001U", " 0O001U", "column 4: 'O' .*a digit"),
            (2, " 00001 ", " 0O001 ", "column 4: 'O' .*a digit"),
            (1, "20284.07", "20400.07", "columns 21-32, day of the year"),
            (1, "20284.07", "202 4.07", "without blanks inside"),
            (1, "20284.07", "20284,07", r"column 24: ',' in '1 00001U 16037A   20284,07"),
            (1, " 00001U", " I0001U", "column 3: 'I' .*a letter other than I and O"),
            (1, "00000+0", "0000o+0", "column 59: 'o' .*a digit or a blank"),
            (1, "16037A", "16\x0037A", r"column 12: '\\x00'"),
            (2, "1.7237", "1-7237", r"column 12: '-' .*expected '\.'"),
            (2, "   1.7237", " 181.7237", "columns 9-16, inclination: .*expected 0 to 180"),
            (2, "  67.2351", " 467.2351", "right ascension of the node"),
            (2, " 1.00273124", " 0.00000000", "mean motion"),
            (2, " 1.00273124", "31.00273124", "mean motion"),
        ],
    )
    def test_the_column_at_fault_is_named(self, tmp_path: Path, line: int, old: str, new: str, message: str):
        lines = [GEO_1, GEO_2]
        lines[line - 1] = with_checksum(lines[line - 1].replace(old, new, 1)[:69])
        with pytest.raises(InputError, match=f"line {line}: .*{message}"):
            self.read(tmp_path, "\n".join(lines))

    @pytest.mark.parametrize(
        ("content", "message"),
        [
            ("{0}\n{2}\n{1}\n", "line 1: '1 00001U .*without its line 2"),
            ("{0}\n{1}\n{1}\n", "line 3: '2 00001 .*without its line 1"),
            ("{0}\n{1}\n{2}\n", "line 3: .*without its line 2"),
            ("{0}\n{1}\n<li>{2}\n{1}\n", "line 3: .*does not begin with '1 '"),
            ("{1}\n{0}\n", "no two-line elements.*line 1: '2 00001"),
            ("{0}9\n{1}\n", "line 1: 70 characters in '1 00001U 16037A   20284"),
            ("{0}\n{3}\n", "line 2: 60 characters"),
        ],
    )
    def test_a_broken_set_is_never_passed_over(self, tmp_path: Path, content: str, message: str):
        with pytest.raises(InputError, match=message):
            self.read(tmp_path, content.format(GEO_1, GEO_2, LATER, GEO_2[:60]))

    @pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"])
    def test_encodings(self, tmp_path: Path, encoding: str):
        assert self.read(tmp_path, f"{GEO_1}\r\n{GEO_2}\r\n".encode(encoding))[0].lines == (GEO_1, GEO_2)

    def test_the_nearest_set(self, tmp_path: Path):
        """Across a turn of the year; of two sets of one epoch the last on file counts."""
        old, new = (changed(GEO_1, "20284.07341138", day) for day in ("20365.50000000", "21002.50000000"))
        corrected = changed(GEO_2, "88.7233", "89.7233")
        found = self.read(tmp_path, "\n".join([new, GEO_2, old, GEO_2, new, corrected]))
        days = Time(["2020-12-20", "2020-12-31T23:00", "2021-01-01T12:00:01", "2021-06-01"]).jd
        chosen = nearest(found, days)
        assert [found[k].lines[0] for k in chosen] == [old, old, new, new]
        assert found[chosen[-1]].lines[1] == corrected

    @pytest.mark.skipif(not CASES.is_dir(), reason="../shared/cases is not there")
    def test_files_that_went_wrong(self):
        assert [one.epoch for one in read_elements(CASES / "bom_two.txt")] == [2461101.0, 2460976.0]
        assert read_elements(CASES / "mccants.txt")[0].epoch == pytest.approx(2461101.30903846, abs=1e-8)
        with pytest.raises(InputError, match=r"column 4: ' ' in '1   511U 62049D   26060"):
            read_elements(CASES / "spaceid.txt")


class TestDecay:
    """A low orbit with strong drag: SGP4 says so for some days, and then gives positions without an error."""

    LINES = (
        with_checksum("1 77777U 26001A   26058.12407234  .09435527  24934+0  44853-1 0  999x"),
        with_checksum("2 77777  98.5849 110.9278 0014449 269.2407  90.7207 15.92146194 2668x"),
    )
    EPOCH = Time("2026-02-27T02:58:39.85", scale="utc")

    def scene(self, folder: Path, effects: str = "") -> Scene:
        text = SCENE.replace(TLE, f'tle = ["{self.LINES[0]}", "{self.LINES[1]}"]\n\n')
        return Scene.from_toml(text.replace('["self_shadowing"]', f'["self_shadowing"{effects}]'))

    def codes(self, days: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        satellite = Satrec.twoline2rv(*self.LINES, WGS72)
        jd = np.full(days.size, satellite.jdsatepoch)
        codes, position, _ = satellite.sgp4_array(jd, satellite.jdsatepochF + days)
        return codes, np.linalg.norm(position, axis=-1)

    def test_what_sgp4_says(self):
        """It fails from day 1 on, and is silent from day 4 on at more than twice the first radius."""
        codes, radius = self.codes(np.array([0.5, 2.0, 4.0, 11.0]))
        assert list(codes) == [0, 6, 0, 0]
        assert radius[0] < 6700 < 14000 < radius[2] < 9e7 < radius[3]

    @pytest.mark.parametrize("days", [2.0, 3.768, 4.0, 11.0, 400.0, -30.0])
    def test_nothing_counts_after_a_decay(self, tmp_path: Path, days: float):
        start = (self.EPOCH + TimeDelta(days, format="jd")).isot
        with pytest.raises(
            InputError, match=r"SGP4 fails at 20.*of these is 2026-02-27T02:58:39, .* days"
        ) as caught:
            torchlc.simulate(self.scene(tmp_path), start=start, hours=1, cadence=300)
        side = "before" if days > 0 else "after"
        assert f"{abs(days):.1f} days {side} it" in str(caught.value)

    def test_good_days_stay(self, tmp_path: Path):
        start = (self.EPOCH + TimeDelta(0.2, format="jd")).isot
        scene = self.scene(tmp_path)
        curve = torchlc.simulate(scene, start=start, hours=1, cadence=300)
        assert len(curve.mag) == 13

    def test_an_offset_must_not_lead_beyond_the_decay(self, tmp_path: Path):
        """SGP4 fails from 0.963 days on; half an hour before it an offset of an hour leads beyond."""
        start = (self.EPOCH + TimeDelta(0.94, format="jd")).isot
        with pytest.raises(InputError, match="which the light curve or an offset in time may reach"):
            torchlc.simulate(self.scene(tmp_path), start=start, hours=0.1, cadence=60)

    def test_a_radius_that_the_orbit_does_not_have(self):
        """Drag that is no drag: a positive exponent of B* throws a high orbit off within a revolution."""
        first = changed(GEO_1, " 00000+0 0", " 99999+9 0")
        elements = ElementSet((first, GEO_2), None)
        epoch = Time(Satrec.twoline2rv(first, GEO_2, WGS72).jdsatepoch, 0.07341138, format="jd", scale="utc")
        days = np.array([0.0, -0.5, -5.0, 50.0])
        satellite = Satrec.twoline2rv(first, GEO_2, WGS72)
        codes, position, _ = satellite.sgp4_array(
            np.full(4, satellite.jdsatepoch), satellite.jdsatepochF + days
        )
        radius = np.linalg.norm(position, axis=-1)
        _, found = elements.positions(epoch + TimeDelta(days, format="jd"))
        off = (codes != 0) | ~((radius > 36000) & (radius < 48000))
        assert off.any() and (found[off] != 0).all()

    @pytest.mark.parametrize("lines", [(GEO_1, GEO_2), ISS])
    def test_orbits_that_last_are_as_sgp4_has_them(self, lines: tuple[str, str]):
        satellite = Satrec.twoline2rv(*lines, WGS72)
        start = Time(satellite.jdsatepoch, satellite.jdsatepochF, format="jd", scale="utc")
        time = start + TimeDelta(np.linspace(-40, 40, 400), format="jd")
        position, codes = ElementSet(lines, None).positions(time)
        assert not codes.any()
        np.testing.assert_array_equal(position, sgp4_states(lines, time)[0])
