"""Scenes and recordings as they should be, which tests take or change."""

from __future__ import annotations

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
