"""Scenes that are refused, or mended with a word."""

from __future__ import annotations

from tests.good_input import (
    ALTAZ_SCENE,
    BODY,
    BODY_MATERIAL,
    MESH,
    PANEL_N,
    SCENE,
    STATION,
    TLE,
    VECTOR_SCENE,
)
from tests.input_cases import case_of, scene_case

SCENE_CASES = [
    scene_case("not TOML", "[orbit]", "[orbit", "line 4, column"),
    scene_case("key twice", 'name = "box-wing"', 'name = "a"\nname = "b"', "line 3"),
    case_of("deep nesting", "TOML", scene="a = " + "[" * 50_000),
    case_of("empty scene", "format: missing", scene=""),
    case_of("binary scene", "not UTF-8 text", scene=b'name = "\xff\xfe"'),
    case_of("huge scene", "more than 1 MiB", scene=SCENE + "#" * (1 << 20)),
    scene_case("wrong format", "torchlc-scene/1", "torchlc-scene/9", "format: 'torchlc-scene/9'"),
    scene_case("no format", 'format = "torchlc-scene/1"\n', "", "format: missing"),
    scene_case("unknown key", "size = [2.0", "sise = [2.0", "components[0].sise: unknown key"),
    scene_case("unknown key, hint", "size = [2.0", "sise = [2.0", "Did you mean 'size'?"),
    scene_case("unknown table", "[model.parameters]", "[modle]\n[model.parameters]", "modle: unknown key"),
    scene_case("missing attitude", '[attitude]\nmode = "nadir"\n', "", "attitude: missing"),
    scene_case("missing size", "size = [2.0, 1.7, 2.2]\n", "", "components[0].size: missing"),
    scene_case("missing shape", 'shape = "box"\n', "", "components[0].shape: missing"),
    scene_case("unknown shape", '"plate"', '"plat"', "components[1].shape: 'plat'"),
    scene_case(
        "size as text",
        "[2.0, 1.7, 2.2]",
        '["2.0", 1.7, 2.2]',
        "components[0].size[0]: '2.0'; expected a number",
    ),
    scene_case("size as true", "[2.0, 1.7, 2.2]", "[true, 1.7, 2.2]", "components[0].size[0]: True"),
    scene_case("two sizes", "[2.0, 1.7, 2.2]", "[2.0, 1.7]", "components[0].size[2]: missing"),
    scene_case(
        "four sizes", "[2.0, 1.7, 2.2]", "[2.0, 1.7, 2.2, 1]", "components[0].size: 4 values; expected 3"
    ),
    scene_case(
        "negative size", "[2.0, 1.7, 2.2]", "[2.0, -1.7, 2.2]", "components[0].size[1]: -1.7; expected > 0"
    ),
    scene_case("infinite size", "[2.0, 1.7, 2.2]", "[2.0, inf, 2.2]", "components[0].size[1]: inf"),
    scene_case("huge integer", "height = 110.0", "height = 1" + "0" * 400, "stations[0].height"),
    scene_case(
        "integer of 5000 digits", "height = 110.0", "height = 0x" + "f" * 5000, "an integer of 20000 bits"
    ),
    case_of("too many components", "2003 values; expected at most", scene=SCENE.replace(BODY, BODY * 2002)),
    scene_case("zero normal", "u = [1, 0, 0]", "u = [0, 0, 0]", "components[1].u: [0.0, 0.0, 0.0]"),
    scene_case("skew plate", "u = [1, 0, 0]", "u = [1, 1, 0]", "components[1].v: 45.000 deg"),
    scene_case("tracks the Moon", '"sun"', '"moon"', "components[1].tracks.target: 'moon'"),
    scene_case("tracks no axis", ", axis = [0, 1, 0] }", " }", "components[1].tracks.axis: missing"),
    scene_case(
        "name twice and meant by an effect",
        'name = "panel"',
        'name = "body"',
        "components[1].name: 'body' again",
        base=SCENE.replace("body]", "hull]")
        .replace('material = "body"', 'material = "hull"')
        .replace('["self_shadowing"]', '["color_term"]')
        .replace("[model.parameters]", '[model.parameters]\n"color_term.mag[body]" = 0.1'),
    ),
    scene_case(
        "name twice",
        'name = "panel"',
        'name = "body"',
        "2 have the name 'body'. They are called 'body 1', 'body 2' here",
        outcome="warning",
    ),
    scene_case("name in brackets", 'name = "panel"', 'name = "panel[1]"', "components[1].name"),
    scene_case(
        "no component",
        SCENE[SCENE.index("[[components]]") : SCENE.index("[materials.body]")],
        "",
        "components",
    ),
    scene_case(
        "face of no box", '"body"\n\n', '"body"\nface_materials = { up = "body" }\n\n', "face_materials.up"
    ),
    scene_case("unknown material", 'material = "panel"', 'material = "pannel"', "Did you mean 'panel'?"),
    scene_case(
        "unused material",
        "[materials.body]",
        BODY_MATERIAL.replace("body", "spare") + "[materials.body]",
        "spare",
    ),
    scene_case(
        "unknown preset", "n = 1000.0\nr_spec = 0.3\nr_diff = 0.3", 'preset = "kaptn"', "body.preset: 'kaptn'"
    ),
    scene_case(
        "preset of another model",
        "n = 1000.0",
        'model = "lambert"\npreset = "kapton"',
        "as of preset 'kapton'",
    ),
    scene_case("unknown model", '"ashikhmin-shirley"', '"ashikmin"', "materials.panel.model: 'ashikmin'"),
    scene_case("key of another model", "n = 1000.0", "albedo = 0.3", "materials.body.albedo: unknown key"),
    scene_case("missing n", "n = 1000.0\n", "", "materials.body.n: missing"),
    scene_case("n and n_u", "n = 1000.0", "n = 1000.0\nn_u = 10.0", "materials.body.n_u: given beside n"),
    scene_case("n_u alone", "n = 1000.0", "n_u = 10.0", "materials.body.n_v: missing"),
    scene_case(
        "more light than comes in", "r_diff = 0.3", "r_diff = 0.8", "materials.body: r_spec + r_diff = 1.1"
    ),
    scene_case(
        "negative reflectance",
        "r_diff = 0.3",
        "r_diff = -0.1",
        "materials.body.r_diff: -0.1; expected 0 to 1",
    ),
    scene_case("only a value", PANEL_N, "n = { value = 200.0 }", "materials.panel.n: only a value"),
    scene_case("one bound", PANEL_N, "n = { value = 200.0, low = 1.0 }", "materials.panel.n: one bound only"),
    scene_case(
        "low above high", "low = 1.0, high = 1e6", "low = 1e6, high = 1.0", "materials.panel.n: low 1e+06"
    ),
    scene_case(
        "value outside",
        "value = 200.0",
        "value = 0.5",
        "materials.panel.n.value: 0.5; expected between low 1",
    ),
    scene_case("loguniform from 0", "low = 1.0", "low = 0.0", "materials.panel.n.low: 0; expected > 0"),
    scene_case("isotropic number", '"loguniform"', '"isotropic"', "materials.panel.n.high: 1e+06"),
    scene_case("unknown prior", '"loguniform"', '"flat"', "materials.panel.n.prior: 'flat'"),
    scene_case("negative sigma", "sigma = 0.02", "sigma = -0.02", "model.parameters.zero_point.sigma"),
    scene_case("uniform with sigma", '"normal" }', '"uniform" }', "model.parameters.zero_point.sigma"),
    scene_case("normal without sigma", '"loguniform"', '"normal"', "materials.panel.n.prior: no sigma"),
    scene_case(
        "lognormal at 0",
        'sigma = 0.02, prior = "normal"',
        'sigma = 1.0, prior = "lognormal"',
        "zero_point.value",
    ),
    scene_case(
        "a size per curve",
        "size = [2.0,",
        'size = [{ value = 2.0, low = 1.0, high = 3.0, per = "curve" },',
        'size[0].per: "curve"',
    ),
    scene_case(
        "a material per night",
        "n = 1000.0",
        'n = { value = 9.0, low = 1.0, high = 99.0, per = "night" }',
        'materials.body.n.per: "night"',
    ),
    scene_case("unknown per", "sigma = 0.02,", 'sigma = 0.02, per = "week",', "zero_point.per: 'week'"),
    scene_case(
        "bound beyond physics",
        "high = 1.0 }",
        "high = 2.0 }",
        "materials.panel.r_spec.high: 2; expected 0 to 1",
    ),
    scene_case(
        "free table, unknown key", "sigma = 0.02", "sd = 0.02", "model.parameters.zero_point.sd: unknown key"
    ),
    scene_case("checksum, line 1", "9993", "9994", "orbit.tle[0]: checksum '4'; expected 3"),
    scene_case("checksum, line 2", "67.2351", "67.2352", "orbit.tle[1]: checksum '6'; expected 7"),
    scene_case("TLE, a comma", "  67.2351", "  67,2351", "orbit.tle[1]: column 21: ','"),
    scene_case("short TLE line", " 15966", "15966", "orbit.tle[1]: 68 characters"),
    scene_case("TLE lines swapped", '"1 00001U', '"2 00001U', "orbit.tle[0]"),
    scene_case("two satellites", "2 00001 ", "2 00010 ", "catalogue numbers 00001 and 00010"),
    scene_case(
        "TLE columns shifted", " 1.00273124 1", "1.002731240 1", "the columns of a two-line element set"
    ),
    scene_case(
        "one TLE line",
        '"2 00001   1.7237  67.2351 0007471   0.1818  88.7233  1.00273124 15966"',
        "",
        "orbit.tle[1]",
    ),
    scene_case("two kinds of orbit", "[orbit]", '[orbit]\nvectors = "icrs"', "orbit: more than one"),
    scene_case("no orbit", TLE, "\n", "orbit: none of them"),
    scene_case("unknown frame", '"icrs"', '"teme"', "orbit.vectors: 'teme'", VECTOR_SCENE),
    scene_case("no station", STATION, "", "stations: no station"),
    scene_case("station twice", "[attitude]", STATION + "[attitude]", "stations[1].id: 'weihai' again"),
    scene_case(
        "latitude beyond the pole", "37.536", "97.536", "stations[0].latitude: 97.536; expected -90 to 90"
    ),
    scene_case("unknown mode", '"nadir"', '"zenith"', "attitude.mode: 'zenith'"),
    scene_case(
        "key of another mode", '"nadir"', '"nadir"\nx_angle = 3.0', "attitude.x_angle: a key that does not"
    ),
    scene_case("spin without axis", '"nadir"', '"nadir"\nspin_rate = 1.0', "attitude.spin_axis"),
    scene_case(
        "spin about nothing", '"nadir"', '"sun"\nspin_rate = 1.0\nspin_axis = [0, 0, 0]', "attitude.spin_axis"
    ),
    scene_case(
        "unreadable epoch",
        '"nadir"',
        '"sun"\nspin_rate = 1\nspin_axis = [0, 0, 1]\nspin_epoch = "soon"',
        "'soon'",
    ),
    scene_case("pole without period", '"nadir"', '"spin-pole"\npole = [0, 90]', "attitude.period: missing"),
    scene_case(
        "period of 0",
        '"nadir"',
        '"spin-pole"\npole = [0, 90]\nperiod = 0\nphase = 0\nepoch = 2451545',
        "attitude.period: 0; expected > 0",
    ),
    scene_case(
        "no quaternion file", '"nadir"', '"quaternions"\nfile = "q.csv"', "attitude.file: no file 'q.csv'"
    ),
    scene_case("no mesh file", BODY, MESH, "components[0].file: no file 'body.obj'"),
    scene_case("mesh outside", BODY, MESH.replace("body.obj", "../body.obj"), "a relative path inside"),
    scene_case("mesh elsewhere", BODY, MESH.replace("body.obj", "/etc/passwd"), "a relative path inside"),
    scene_case(
        "nadir from alt-az", '"yaw-steering"', '"nadir"', "attitude.mode: nadir needs a velocity", ALTAZ_SCENE
    ),
    scene_case("unknown effect", '["self_shadowing"]', '["self_shading"]', "Did you mean 'self_shadowing'?"),
    scene_case("effect twice", '["self_shadowing"]', '["light_time", "light_time"]', "model.effects[1].name"),
    scene_case(
        "parameter of no effect",
        "zero_point =",
        '"panel_ofset.deg" = 1.0\nzero_point =',
        "unknown effect 'panel_ofset'",
    ),
    scene_case("parameter without effect", "zero_point =", "zeropoint = 1.0\nzero_point =", "unknown key"),
    case_of(
        "placeholder satellite",
        "placeholder xxxxx",
        scene=SCENE.replace("00001", "xxxxx").replace("9993", "9992").replace("15966", "15965"),
        outcome="warning",
    ),
]
