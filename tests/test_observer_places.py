"""The station of a row by the latitude and longitude of its observer, under the names that people use."""

from __future__ import annotations

import pytest

from tests.good_input import SCENE
from tests.observers_night import EXPORTS, holds, table
from tests.test_observers_files import with_the_station
from torchlc.errors import InputError
from torchlc.readers.roles import looks_like_site, named_as_site

WEIHAI = ",37.54,122.05,110"
TWO = SCENE.replace(
    "[attitude]",
    '[[stations]]\nid = "perth"\nlatitude = -31.95\nlongitude = 115.86\nheight = 20.0\n\n[attitude]',
)


def taken(recording) -> str:
    (line,) = [text for text in recording.warnings if text.startswith(("columns: ", "read as "))]
    return line


@pytest.mark.parametrize(
    "names",
    [
        "site_lat,site_lon,site_height", "obs_lat_deg,obs_lon_deg,obs_alt_m", "Latitude,Longitude,Altitude (m)", "lat,lon,alt_m",
        "Station Lat,Station Long,Station Height (m)", "observer_latitude_deg,observer_longitude_deg,observer_altitude_m",
        "stationLatitude,stationLongitude,stationElevation_m", "Lat (N),Lon (E),Elevation_m", "lat_site,lon_site,height_m",
    ],
)  # fmt: skip
def test_usual_names_say_the_station(read, names: str):
    text = table(f"JD,Mag,Err,satellite,norad,{names}", more=f",SAT 1,00001{WEIHAI}")
    recording = read(text, TWO)
    holds(recording)
    assert {recording.station_ids[k] for k in recording.station} == {"weihai"}
    line = taken(recording)
    assert "not used" not in line
    for name, role in zip(names.split(","), ("site_lat", "site_lon", "site_height"), strict=True):
        assert f"{name} as {role}" in line


def test_each_row_has_the_station_at_its_place(read):
    rows = table("JD,Mag,Err,lat,lon", more=",37.54,122.05").rstrip("\n").split("\n")
    rows[2] = rows[2].replace("37.54,122.05", "-31.94,-244.13")
    recording = read("\n".join(rows) + "\n", TWO)
    assert [recording.station_ids[k] for k in recording.station] == ["weihai", "perth", "weihai"]


def test_an_observer_elsewhere_is_refused_with_the_lines_to_add(read):
    text = table("JD,Mag,Err,site_lat,site_lon,alt_m", more=",-30.0,20.0,1200")
    with pytest.raises(
        InputError, match=r"row 1: an observer at -30, 20; expected .*height = 1200"
    ) as refused:
        read(text, SCENE)
    holds(read(text, with_the_station(str(refused.value))))


@pytest.mark.parametrize(
    ("names", "cells", "said"),
    [
        ("lat,lon", ",-30.0,20.0", "lat, lon (at no station of the scene)"),
        ("Latitude,Longitude (W)", ",37.54,237.95", "Latitude, Longitude (W)"),
        ("lat,lon", ",37:32:10,122:03:00", "lat, lon ('37:32:10' is no number of degrees)"),
        ("site_lat,site_lon", ",,", "site_lat, site_lon (no degrees in them)"),
        ("site_lat,other", ",37.54,122.05", "site_lat"),
        ("station,lat,lon", ",weihai,37.54,122.05", "lat, lon (the station is named)"),
    ],
)
def test_what_is_not_used_is_said_in_the_line_of_what_is(read, names: str, cells: str, said: str):
    recording = read(table(f"JD,Mag,Err,{names}", more=cells), SCENE)
    holds(recording)
    assert taken(recording).endswith(f"; not used: {said}")


def test_without_a_scene_the_place_is_the_name(read):
    assert read(table("JD,Mag,Err,site_lat,site_lon", more=",37.54,122.05")).station_ids == ("37.54, 122.05",)
    recording = read(table("JD,Mag,Err,lat,lon", more=",37.54,122.05"))
    assert "not used: lat, lon (no scene)" in taken(recording)


def test_the_user_says_which_columns_they_are(read):
    text = table("JD,Mag,Err,B,L", more=",-30,20")
    with pytest.raises(InputError, match="an observer at -30, 20"):
        read(text, SCENE, columns="site_lat=B,site_lon=L")


def test_units_of_places_are_converted_and_directions_are_none(read):
    radians = table("JD,Mag,Err,site_lat [rad],site_lon [rad]", more=",0.65520,2.13017")
    recording = read(radians, TWO)
    assert recording.station_ids[recording.station[0]] == "weihai"


def test_score_with_other_names_of_the_place(read):
    text = EXPORTS["SCORE"]
    for axis in ("latitude_deg", "longitude_deg", "altitude_m"):
        text = text.replace(f"observer_{axis}", f"station_{axis}")
    recording = read(text, TWO)
    assert recording.station_ids[recording.station[0]] == "weihai"
    assert (
        "place of the observer (station_latitude_deg, station_longitude_deg, station_altitude_m) as station"
        in taken(recording)
    )
    with pytest.raises(InputError, match="an observer at -30, 20"):
        read(text.replace("37.54,122.05", "-30.0,20.0"), SCENE)
    unknown = EXPORTS["SCORE"].replace("observer_latitude_deg,observer_longitude_deg", "lat_south,lon_west")
    assert "none (not used: lat_south, lon_west) as station" in taken(read(unknown, SCENE))


def test_coordinates_of_something_else_are_no_place():
    others = ("obs_lat_body", "sun_lon_body", "ecl_lon", "sat_lat", "sub_lon", "PAB lon", "flatness", "colon")
    for name in others:
        assert named_as_site(name) is None and not looks_like_site(name), name
    assert named_as_site("long_exposure_flag") is None
    assert (
        named_as_site("alt") is None
        and named_as_site("obs_alt") is None
        and named_as_site("Longitude (W)") is None
    )
    assert looks_like_site("Longitude (W)") and looks_like_site("lat_south")
