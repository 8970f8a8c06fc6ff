"""Broken, odd and merely unusual inputs: the files of each, and what must come of them.

Each case is a small change of one of the good scenes and recordings below. ``outcome`` is "exit2" (refused
with one line that holds ``message``), "dropped" (read, one row counted under the reason ``message``) or
"warning" (read, with a warning that holds it).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

SCENE = """\
format = "torchlc-scene/1"
name = "box-wing"

[orbit]
tle = ["1 00001U 16037A   20284.07341138 -.00000354  00000-0  00000+0 0  9993",
       "2 00001   1.7237  67.2351 0007471   0.1818  88.7233  1.00273124 15966"]

[[stations]]
id = "weihai"
latitude = 37.536
longitude = 122.05
height = 110.0

[attitude]
mode = "nadir"

[[components]]
name = "body"
shape = "box"
size = [2.0, 1.7, 2.2]
centre = [0, 0, 0]
material = "body"

[[components]]
name = "panel"
shape = "plate"
size = [1.7, 6.6]
centre = [0, 5.75, 0]
u = [1, 0, 0]
v = [0, 1, 0]
tracks = { target = "sun", axis = [0, 1, 0] }
material = "panel"

[materials.body]
n = 1000.0
r_spec = 0.3
r_diff = 0.3

[materials.panel]
model = "ashikhmin-shirley"
n = { value = 200.0, low = 1.0, high = 1e6, prior = "loguniform" }
r_spec = { value = 0.05, low = 0.0, high = 1.0 }
r_diff = { value = 0.05, low = 0.0, high = 1.0 }

[model]
effects = ["self_shadowing"]
[model.parameters]
zero_point = { value = 0.0, sigma = 0.02, prior = "normal" }
band_sun_magnitude = -26.7
"""

RECORDING = """\
time,mag,mag_err
2020-10-17T15:00:00,12.50,0.02
2020-10-17T15:10:00,12.31,0.02
2020-10-17T15:20:00,12.12,0.02
2020-10-17T15:30:00,11.83,0.02
2020-10-17T15:40:00,11.52,0.02
"""

TLE = SCENE[SCENE.index("tle = ") : SCENE.index("[[stations]]")]
STATION = SCENE[SCENE.index("[[stations]]") : SCENE.index("[attitude]")]
BODY = SCENE[SCENE.index("[[components]]") : SCENE.index('[[components]]\nname = "panel"')]
PANEL_N = 'n = { value = 200.0, low = 1.0, high = 1e6, prior = "loguniform" }'
BODY_MATERIAL = SCENE[SCENE.index("[materials.body]") : SCENE.index("[materials.panel]")]

VECTOR_SCENE = SCENE.replace(TLE, 'vectors = "icrs"\n\n').replace(STATION, "")
VECTOR_NAMES = "sun_x,sun_y,sun_z,obs_x,obs_y,obs_z,r_x,r_y,r_z,v_x,v_y,v_z"
VECTOR_RECORDING = f"""\
time,mag,mag_err,{VECTOR_NAMES}
2020-10-17T15:00:00,12.50,0.02,1.3e8,-6e7,-2e7,-36000,-1000,3000,42164,0,0,0,3.07,0
2020-10-17T15:10:00,12.31,0.02,1.3e8,-6e7,-2e7,-36000,-1100,3000,42123,1844,0,-0.13,3.07,0
"""

ALTAZ_SCENE = SCENE.replace(TLE, "altaz = true\n\n").replace('"nadir"', '"yaw-steering"')
ALTAZ_RECORDING = """\
time,mag,alt,az,height
2020-10-17T15:00:00,7.1,31.0,54.0,550
2020-10-17T15:01:00,6.9,35.0,56.0,550
2020-10-17T15:02:00,6.8,39.0,59.0,550
"""

ECSV = """\
# %ECSV 1.0
# ---
# datatype:
# - {name: time, datatype: string}
# - {name: mag, unit: mag, datatype: float64}
# - {name: mag_err, unit: mag, datatype: float64}
# meta: {time_scale: utc}
# schema: astropy-2.0
time mag mag_err
2020-10-17T15:00:00 12.5 0.02
2020-10-17T15:10:00 12.3 0.02
"""

ECSV_VECTORS = (
    "# %ECSV 1.0\n# ---\n# datatype:\n"
    "# - {name: time, datatype: string}\n# - {name: mag, datatype: float64}\n"
    + "".join(f"# - {{name: {name}, unit: AU, datatype: float64}}\n" for name in VECTOR_NAMES.split(",")[:9])
    + "".join(f"# - {{name: v_{axis}, unit: AU / d, datatype: float64}}\n" for axis in "xyz")
    + "# meta: {frame: ecliptic J2000}\n"
    + f"time mag {VECTOR_NAMES.replace(',', ' ')}\n"
    + "2020-10-17T15:00:00 12.5 1 0 0 0 0 1 1 0 0 0 0 1\n"
)

TETRAHEDRON = """\
v 0 0 0
v 1 0 0
v 0 1 0
v 0 0 1
f 1 3 2
f 1 2 4
f 1 4 3
f 2 3 4
"""
MESH = BODY.replace("box", "mesh").replace("size = [2.0, 1.7, 2.2]", 'file = "body.obj"\nscale = 2.0')
MESH_SCENE = SCENE.replace(BODY, MESH)


@dataclass(frozen=True)
class Case:
    """Files by name (``scene.toml`` and ``recording.csv`` are the two loaded), and what must come of them."""

    name: str
    files: dict[str, str | bytes]
    outcome: str
    message: str

    def write(self, folder: Path) -> tuple[Path, Path]:
        """Write the files into ``folder``; the paths of scene and recording."""
        for name, content in self.files.items():
            path = folder / name
            path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return folder / "scene.toml", folder / "recording.csv"


def _case(
    name: str,
    message: str,
    *,
    scene: str | bytes = SCENE,
    recording: str | bytes = RECORDING,
    outcome: str = "exit2",
) -> Case:
    return Case(name, {"scene.toml": scene, "recording.csv": recording}, outcome, message)


def _scene(name: str, old: str, new: str, message: str, base: str = SCENE, outcome: str = "exit2") -> Case:
    assert base.count(old) >= 1, (name, old)
    recording = {VECTOR_SCENE: VECTOR_RECORDING, ALTAZ_SCENE: ALTAZ_RECORDING}.get(base, RECORDING)
    return _case(name, message, scene=base.replace(old, new, 1), recording=recording, outcome=outcome)


def _rows(name: str, old: str, new: str, message: str, base: str = RECORDING, outcome: str = "exit2") -> Case:
    assert base.count(old) >= 1, (name, old)
    scene = {VECTOR_RECORDING: VECTOR_SCENE, ALTAZ_RECORDING: ALTAZ_SCENE}.get(base, SCENE)
    return _case(name, message, scene=scene, recording=base.replace(old, new, 1), outcome=outcome)


SCENE_CASES = [
    _scene("not TOML", "[orbit]", "[orbit", "line 4, column"),
    _scene("key twice", 'name = "box-wing"', 'name = "a"\nname = "b"', "line 3"),
    _case("deep nesting", "TOML", scene="a = " + "[" * 50_000),
    _case("empty scene", "format: missing", scene=""),
    _case("binary scene", "not UTF-8 text", scene=b'name = "\xff\xfe"'),
    _case("huge scene", "more than 1 MiB", scene=SCENE + "#" * (1 << 20)),
    _scene("wrong format", "torchlc-scene/1", "torchlc-scene/9", "format: 'torchlc-scene/9'"),
    _scene("no format", 'format = "torchlc-scene/1"\n', "", "format: missing"),
    _scene("unknown key", "size = [2.0", "sise = [2.0", "components[0].sise: unknown key"),
    _scene("unknown key, hint", "size = [2.0", "sise = [2.0", "Did you mean 'size'?"),
    _scene("unknown table", "[model.parameters]", "[modle]\n[model.parameters]", "modle: unknown key"),
    _scene("missing attitude", '[attitude]\nmode = "nadir"\n', "", "attitude: missing"),
    _scene("missing size", "size = [2.0, 1.7, 2.2]\n", "", "components[0].size: missing"),
    _scene("missing shape", 'shape = "box"\n', "", "components[0].shape: missing"),
    _scene("unknown shape", '"plate"', '"plat"', "components[1].shape: 'plat'"),
    _scene(
        "size as text",
        "[2.0, 1.7, 2.2]",
        '["2.0", 1.7, 2.2]',
        "components[0].size[0]: '2.0'; expected a number",
    ),
    _scene("size as true", "[2.0, 1.7, 2.2]", "[true, 1.7, 2.2]", "components[0].size[0]: True"),
    _scene("two sizes", "[2.0, 1.7, 2.2]", "[2.0, 1.7]", "components[0].size[2]: missing"),
    _scene("four sizes", "[2.0, 1.7, 2.2]", "[2.0, 1.7, 2.2, 1]", "components[0].size: 4 values; expected 3"),
    _scene(
        "negative size", "[2.0, 1.7, 2.2]", "[2.0, -1.7, 2.2]", "components[0].size[1]: -1.7; expected > 0"
    ),
    _scene("infinite size", "[2.0, 1.7, 2.2]", "[2.0, inf, 2.2]", "components[0].size[1]: inf"),
    _scene("huge integer", "height = 110.0", "height = 1" + "0" * 400, "stations[0].height"),
    _scene(
        "integer of 5000 digits", "height = 110.0", "height = 0x" + "f" * 5000, "an integer of 20000 bits"
    ),
    _case("too many components", "2003 values; expected at most", scene=SCENE.replace(BODY, BODY * 2002)),
    _scene("zero normal", "u = [1, 0, 0]", "u = [0, 0, 0]", "components[1].u: [0.0, 0.0, 0.0]"),
    _scene("skew plate", "u = [1, 0, 0]", "u = [1, 1, 0]", "components[1].v: 45.000 deg"),
    _scene("tracks the Moon", '"sun"', '"moon"', "components[1].tracks.target: 'moon'"),
    _scene("tracks no axis", ", axis = [0, 1, 0] }", " }", "components[1].tracks.axis: missing"),
    _scene(
        "name twice and meant by an effect",
        'name = "panel"',
        'name = "body"',
        "components[1].name: 'body' again",
        base=SCENE.replace("body]", "hull]")
        .replace('material = "body"', 'material = "hull"')
        .replace('["self_shadowing"]', '["color_term"]')
        .replace("[model.parameters]", '[model.parameters]\n"color_term.mag[body]" = 0.1'),
    ),
    _scene(
        "name twice",
        'name = "panel"',
        'name = "body"',
        "2 have the name 'body'. They are called 'body 1', 'body 2' here",
        outcome="warning",
    ),
    _scene("name in brackets", 'name = "panel"', 'name = "panel[1]"', "components[1].name"),
    _scene(
        "no component",
        SCENE[SCENE.index("[[components]]") : SCENE.index("[materials.body]")],
        "",
        "components",
    ),
    _scene(
        "face of no box", '"body"\n\n', '"body"\nface_materials = { up = "body" }\n\n', "face_materials.up"
    ),
    _scene("unknown material", 'material = "panel"', 'material = "pannel"', "Did you mean 'panel'?"),
    _scene(
        "unused material",
        "[materials.body]",
        BODY_MATERIAL.replace("body", "spare") + "[materials.body]",
        "spare",
    ),
    _scene(
        "unknown preset", "n = 1000.0\nr_spec = 0.3\nr_diff = 0.3", 'preset = "kaptn"', "body.preset: 'kaptn'"
    ),
    _scene(
        "preset of another model",
        "n = 1000.0",
        'model = "lambert"\npreset = "kapton"',
        "as of preset 'kapton'",
    ),
    _scene("unknown model", '"ashikhmin-shirley"', '"ashikmin"', "materials.panel.model: 'ashikmin'"),
    _scene("key of another model", "n = 1000.0", "albedo = 0.3", "materials.body.albedo: unknown key"),
    _scene("missing n", "n = 1000.0\n", "", "materials.body.n: missing"),
    _scene("n and n_u", "n = 1000.0", "n = 1000.0\nn_u = 10.0", "materials.body.n_u: given beside n"),
    _scene("n_u alone", "n = 1000.0", "n_u = 10.0", "materials.body.n_v: missing"),
    _scene(
        "more light than comes in", "r_diff = 0.3", "r_diff = 0.8", "materials.body: r_spec + r_diff = 1.1"
    ),
    _scene(
        "negative reflectance",
        "r_diff = 0.3",
        "r_diff = -0.1",
        "materials.body.r_diff: -0.1; expected 0 to 1",
    ),
    _scene("only a value", PANEL_N, "n = { value = 200.0 }", "materials.panel.n: only a value"),
    _scene("one bound", PANEL_N, "n = { value = 200.0, low = 1.0 }", "materials.panel.n: one bound only"),
    _scene(
        "low above high", "low = 1.0, high = 1e6", "low = 1e6, high = 1.0", "materials.panel.n: low 1e+06"
    ),
    _scene(
        "value outside",
        "value = 200.0",
        "value = 0.5",
        "materials.panel.n.value: 0.5; expected between low 1",
    ),
    _scene("loguniform from 0", "low = 1.0", "low = 0.0", "materials.panel.n.low: 0; expected > 0"),
    _scene("isotropic number", '"loguniform"', '"isotropic"', "materials.panel.n.high: 1e+06"),
    _scene("unknown prior", '"loguniform"', '"flat"', "materials.panel.n.prior: 'flat'"),
    _scene("negative sigma", "sigma = 0.02", "sigma = -0.02", "model.parameters.zero_point.sigma"),
    _scene("uniform with sigma", '"normal" }', '"uniform" }', "model.parameters.zero_point.sigma"),
    _scene("normal without sigma", '"loguniform"', '"normal"', "materials.panel.n.prior: no sigma"),
    _scene(
        "lognormal at 0",
        'sigma = 0.02, prior = "normal"',
        'sigma = 1.0, prior = "lognormal"',
        "zero_point.value",
    ),
    _scene(
        "a size per curve",
        "size = [2.0,",
        'size = [{ value = 2.0, low = 1.0, high = 3.0, per = "curve" },',
        'size[0].per: "curve"',
    ),
    _scene(
        "a material per night",
        "n = 1000.0",
        'n = { value = 9.0, low = 1.0, high = 99.0, per = "night" }',
        'materials.body.n.per: "night"',
    ),
    _scene("unknown per", "sigma = 0.02,", 'sigma = 0.02, per = "week",', "zero_point.per: 'week'"),
    _scene(
        "bound beyond physics",
        "high = 1.0 }",
        "high = 2.0 }",
        "materials.panel.r_spec.high: 2; expected 0 to 1",
    ),
    _scene(
        "free table, unknown key", "sigma = 0.02", "sd = 0.02", "model.parameters.zero_point.sd: unknown key"
    ),
    _scene("checksum, line 1", "9993", "9994", "orbit.tle[0]: checksum '4'; expected 3"),
    _scene("checksum, line 2", "67.2351", "67.2352", "orbit.tle[1]: checksum '6'; expected 7"),
    _scene("TLE, a comma", "  67.2351", "  67,2351", "orbit.tle[1]: column 21: ','"),
    _scene("short TLE line", " 15966", "15966", "orbit.tle[1]: 68 characters"),
    _scene("TLE lines swapped", '"1 00001U', '"2 00001U', "orbit.tle[0]"),
    _scene("two satellites", "2 00001 ", "2 00010 ", "catalogue numbers 00001 and 00010"),
    _scene("TLE columns shifted", " 1.00273124 1", "1.002731240 1", "the columns of a two-line element set"),
    _scene(
        "one TLE line",
        '"2 00001   1.7237  67.2351 0007471   0.1818  88.7233  1.00273124 15966"',
        "",
        "orbit.tle[1]",
    ),
    _scene("two kinds of orbit", "[orbit]", '[orbit]\nvectors = "icrs"', "orbit: more than one"),
    _scene("no orbit", TLE, "\n", "orbit: none of them"),
    _scene("unknown frame", '"icrs"', '"teme"', "orbit.vectors: 'teme'", VECTOR_SCENE),
    _scene("no station", STATION, "", "stations: no station"),
    _scene("station twice", "[attitude]", STATION + "[attitude]", "stations[1].id: 'weihai' again"),
    _scene(
        "latitude beyond the pole", "37.536", "97.536", "stations[0].latitude: 97.536; expected -90 to 90"
    ),
    _scene("unknown mode", '"nadir"', '"zenith"', "attitude.mode: 'zenith'"),
    _scene(
        "key of another mode", '"nadir"', '"nadir"\nx_angle = 3.0', "attitude.x_angle: a key that does not"
    ),
    _scene("spin without axis", '"nadir"', '"nadir"\nspin_rate = 1.0', "attitude.spin_axis"),
    _scene(
        "spin about nothing", '"nadir"', '"sun"\nspin_rate = 1.0\nspin_axis = [0, 0, 0]', "attitude.spin_axis"
    ),
    _scene(
        "unreadable epoch",
        '"nadir"',
        '"sun"\nspin_rate = 1\nspin_axis = [0, 0, 1]\nspin_epoch = "soon"',
        "'soon'",
    ),
    _scene("pole without period", '"nadir"', '"spin-pole"\npole = [0, 90]', "attitude.period: missing"),
    _scene(
        "period of 0",
        '"nadir"',
        '"spin-pole"\npole = [0, 90]\nperiod = 0\nphase = 0\nepoch = 2451545',
        "attitude.period: 0; expected > 0",
    ),
    _scene(
        "no quaternion file", '"nadir"', '"quaternions"\nfile = "q.csv"', "attitude.file: no file 'q.csv'"
    ),
    _scene("no mesh file", BODY, MESH, "components[0].file: no file 'body.obj'"),
    _scene("mesh outside", BODY, MESH.replace("body.obj", "../body.obj"), "a relative path inside"),
    _scene("mesh elsewhere", BODY, MESH.replace("body.obj", "/etc/passwd"), "a relative path inside"),
    _scene(
        "nadir from alt-az", '"yaw-steering"', '"nadir"', "attitude.mode: nadir needs a velocity", ALTAZ_SCENE
    ),
    _scene("unknown effect", '["self_shadowing"]', '["self_shading"]', "Did you mean 'self_shadowing'?"),
    _scene("effect twice", '["self_shadowing"]', '["light_time", "light_time"]', "model.effects[1].name"),
    _scene(
        "parameter of no effect",
        "zero_point =",
        '"panel_ofset.deg" = 1.0\nzero_point =',
        "unknown effect 'panel_ofset'",
    ),
    _scene("parameter without effect", "zero_point =", "zeropoint = 1.0\nzero_point =", "unknown key"),
    _case(
        "placeholder satellite",
        "placeholder xxxxx",
        scene=SCENE.replace("00001", "xxxxx").replace("9993", "9992").replace("15966", "15965"),
        outcome="warning",
    ),
]

FIRST = "2020-10-17T15:00:00"
SECOND = "2020-10-17T15:10:00"

RECORDING_CASES = [
    _case("empty file", "the file is empty", recording=""),
    _case("blank lines only", "no rows", recording="\n\n\n"),
    _case("header only", "no rows below the header", recording="time,mag,mag_err\n"),
    _case("one row", "1 usable row; expected at least 2", recording="\n".join(RECORDING.split("\n")[:2])),
    _case("UTF-16 that breaks off", "UTF-16 text that is damaged", recording=RECORDING.encode("utf-16")[:-1]),
    _case("not UTF-8", "not UTF-8 text", recording=RECORDING.encode() + b"\xff\x00,1,1\n"),
    _case("binary", "", recording=bytes(range(256)) * 8),
    _case("endless line", "longer than 65536 characters", recording="time,mag\n" + "1" * 100_000),
    _case("endless quote", "", recording=RECORDING + '"' + "x,1\n" * 60_000),
    _rows("no time", "time,", "when,", "no column time"),
    _rows("capital Time", "time,", "Time,", "Time as time", outcome="warning"),
    _rows("no magnitude", "mag,mag_err", "m,m_err", "a column mag or flux"),
    _case("one name only", "is the delimiter", recording=RECORDING.replace(",", "/")),
    _rows("column twice", "mag,mag_err", "mag,mag", "column 'mag' appears twice"),
    _rows("short row", "12.31,0.02", "12.31", "row 2: 2 values; expected 3"),
    _rows("long row", "12.31,0.02", "12,31,0.02", "row 2: 4 values; expected 3"),
    _rows("a word for a number", "12.31", "bright", "row 2, column mag: 'bright'; expected a number"),
    _rows("quoted decimal comma", "12.31", '"12,31"', "Write decimals with a point."),
    _rows("error of 0", "12.31,0.02", "12.31,0", "row 2, column mag_err: 0; expected > 0"),
    _rows("negative error", "12.31,0.02", "12.31,-0.02", "row 2, column mag_err: -0.02"),
    _rows("marker for missing", "12.31", "99.99", "beyond 90 mag", outcome="dropped"),
    _rows("underscore in a number", "12.31", "1_2.31", "Leave out the underscores."),
    _rows("digits of another script", "12.31", "\uff11\uff12.31", "row 2, column mag: '\uff11\uff12.31'"),
    _rows("exponent with d", "12.31", "1.231d1", "Write the exponent with e"),
    _rows("error of 1e-300", "12.31,0.02", "12.31,1e-300", "row 2, column mag_err: 1e-300; expected > 0"),
    _rows("brighter than a limit", "12.31", "<12.31", "as in >18.5"),
    _rows(
        "unreadable time", SECOND, "17 Octember 2020 15:10", "row 2, column time: '17 Octember 2020 15:10'"
    ),
    _rows("blank time", SECOND, "", "row 2, column time: ''"),
    _rows("date without time", SECOND, "2020-10-17", "a time of day beside the date"),
    _rows("31 February", SECOND, "2020-02-31T00:00:00", "row 2, column time: '2020-02-31T00:00:00'"),
    _rows("25 o'clock", SECOND, "2020-10-17T25:00:00", "an existing date and time of day"),
    _rows("second 60 of any minute", SECOND, "2020-10-17T15:09:60", "an existing date"),
    _rows("day 367 of a year", SECOND, "2020:367:15:10:00", "a day of the year from 1 to 366"),
    _rows("local time by name", SECOND, "2020-10-17T23:10:00 CST", "a local time cannot be converted safely"),
    _rows("offset of 40 h", SECOND, "2020-10-17T15:10:00+40:00", "an offset of at most 14 h"),
    _rows("before UTC", FIRST, "1957-10-04T19:28:34", "a time in 1960-2200"),
    _case("MJD as JD", "time_format: mjd", recording="time,mag\n59139.625,12.5\n59139.626,12.4\n"),
    _case("ISO among JD", "row 2, column time", recording=f"time,mag\n2459140.125,12\n{SECOND},12\n"),
    _case("JD among ISO", "row 2, column time", recording=f"time,mag\n{SECOND},12\n2459140.125,12\n"),
    _case(
        "no number",
        "no usable row (2 non-finite); expected at least 1 with finite numbers. A row is left out if a cell is blank, NaN or infinite",
        recording=f"time,mag\n{FIRST},\n{SECOND},nan\n",
    ),
    _case(
        "never above the horizon",
        "column alt: below 0 in 3 rows, which is all that is left",
        scene=ALTAZ_SCENE,
        recording=ALTAZ_RECORDING.replace(",3", ",-3"),
    ),
    _case(
        "unknown station",
        "'canarias'",
        recording=f"time,mag,station\n{FIRST},12,weihai\n{SECOND},12,canarias\n",
    ),
    _case(
        "several stations, no column",
        "no column station",
        scene=SCENE.replace("[attitude]", STATION.replace("weihai", "canarias") + "[attitude]"),
    ),
    _case(
        "negative exposure",
        "column exptime: -1",
        recording=f"time,mag,exptime\n{FIRST},12,-1\n{SECOND},12,1\n",
    ),
    _case("odd flag", "'maybe'", recording=f"time,mag,upper_limit\n{FIRST},12,maybe\n{SECOND},12,true\n"),
    _case("vectors wanted", "no column sun_x", scene=VECTOR_SCENE),
    _rows("no velocity for nadir", "v_x,v_y,v_z", "w_x,w_y,w_z", "no column v_x", VECTOR_RECORDING),
    _rows("observer at the object", "-36000,-1000,3000", "0,0,0", "a vector of length 0", VECTOR_RECORDING),
    _rows("no height for alt-az", ",height", ",h", "no column height", ALTAZ_RECORDING),
    _rows("altitude of 131 deg", "31.0", "131.0", "row 1, column alt: 131", ALTAZ_RECORDING),
    _rows("negative height", "54.0,550", "54.0,-550", "row 1, column height", ALTAZ_RECORDING),
    _rows("local time scale", "time_scale: utc", "time_scale: local", "metadata time_scale: 'local'", ECSV),
    _rows("unknown time scale", "time_scale: utc", "time_scale: gps", "metadata time_scale: 'gps'", ECSV),
    _rows(
        "unknown time format",
        "time_scale: utc",
        "time_format: stardate",
        "metadata time_format: 'stardate'",
        ECSV,
    ),
    _rows("ISO said to be JD", "time_scale: utc", "time_format: jd", "row 1, column time", ECSV),
    _rows(
        "HJD by description", "name: time,", "name: time, description: HJD,", "times at the observer", ECSV
    ),
    _rows("GPS by description", "name: time,", "name: time, description: GPS time,", "one time scale", ECSV),
    _rows("start of exposure", "name: time,", "name: time, description: exposure start,", "exptime", ECSV),
    _rows("local by description", "name: time,", "name: time, description: local time,", "local time", ECSV),
    _rows("magnitudes in km", "{name: mag, unit: mag", "{name: mag, unit: km", "column mag: unit km", ECSV),
    _rows("unknown unit", "{name: mag, unit: mag", "{name: mag, unit: magn", "column mag: unit magn", ECSV),
    _rows("ECSV without types", "# datatype:", "# datatypes:", "unreadable ECSV header", ECSV),
    _rows(
        "ECSV, other columns", "time mag mag_err\n", "time mag err\n", "as declared: time, mag, mag_err", ECSV
    ),
    _rows("ECSV, semicolons", "# datatype:", "# delimiter: ;\n# datatype:", "delimiter ';'", ECSV),
    _case("frames at odds", "ecliptic, but the scene says", scene=VECTOR_SCENE, recording=ECSV_VECTORS),
    _rows("non-finite rows", "12.31", "nan", "non-finite", outcome="dropped"),
    _rows("blank cell", "12.31", "", "non-finite", outcome="dropped"),
    _rows("infinite magnitude", "12.31", "inf", "non-finite", outcome="dropped"),
    _rows(
        "whole duplicate",
        f"{SECOND},12.31,0.02\n",
        f"{SECOND},12.31,0.02\n" * 2,
        "duplicate",
        outcome="dropped",
    ),
    _rows("below the horizon", "31.0", "-3.0", "below the horizon", ALTAZ_RECORDING, outcome="dropped"),
    _rows("out of order", FIRST, "2020-10-17T16:00:00", "have been sorted", outcome="warning"),
    _case(
        "blank errors", "mag_err, taken as absent", recording=RECORDING.replace("0.02", ""), outcome="warning"
    ),
]

CASES = SCENE_CASES + RECORDING_CASES
