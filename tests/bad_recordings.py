"""Recordings that are refused, that lose a row, or that are mended with a word."""

from __future__ import annotations

from tests.good_input import (
    ALTAZ_RECORDING,
    ALTAZ_SCENE,
    ECSV,
    ECSV_VECTORS,
    RECORDING,
    SCENE,
    STATION,
    VECTOR_RECORDING,
    VECTOR_SCENE,
)
from tests.input_cases import case_of, rows_case

FIRST = "2020-10-17T15:00:00"
SECOND = "2020-10-17T15:10:00"
RECORDING_CASES = [
    case_of("empty file", "the file is empty", recording=""),
    case_of("blank lines only", "no rows", recording="\n\n\n"),
    case_of("header only", "no rows below the header", recording="time,mag,mag_err\n"),
    case_of("one row", "1 usable row; expected at least 2", recording="\n".join(RECORDING.split("\n")[:2])),
    case_of(
        "UTF-16 that breaks off", "UTF-16 text that is damaged", recording=RECORDING.encode("utf-16")[:-1]
    ),
    case_of("not UTF-8", "not UTF-8 text", recording=RECORDING.encode() + b"\xff\x00,1,1\n"),
    case_of("binary", "", recording=bytes(range(256)) * 8),
    case_of("endless line", "longer than 65536 characters", recording="time,mag\n" + "1" * 100_000),
    case_of("endless quote", "", recording=RECORDING + '"' + "x,1\n" * 60_000),
    rows_case("no time", "time,", "when,", "no column time"),
    rows_case("capital Time", "time,", "Time,", "Time as time", outcome="warning"),
    rows_case("no magnitude", "mag,mag_err", "m,m_err", "a column mag or flux"),
    case_of("one name only", "is the delimiter", recording=RECORDING.replace(",", "/")),
    rows_case("column twice", "mag,mag_err", "mag,mag", "column 'mag' appears twice"),
    rows_case("short row", "12.31,0.02", "12.31", "row 2: 2 values; expected 3"),
    rows_case("long row", "12.31,0.02", "12,31,0.02", "row 2: 4 values; expected 3"),
    rows_case("a word for a number", "12.31", "bright", "row 2, column mag: 'bright'; expected a number"),
    rows_case("quoted decimal comma", "12.31", '"12,31"', "Write decimals with a point"),
    rows_case("error of 0", "12.31,0.02", "12.31,0", "row 2, column mag_err: 0; expected > 0"),
    rows_case("negative error", "12.31,0.02", "12.31,-0.02", "row 2, column mag_err: -0.02"),
    rows_case("marker for missing", "12.31", "99.99", "beyond 90 mag", outcome="dropped"),
    rows_case("underscore in a number", "12.31", "1_2.31", "Leave out the underscores."),
    rows_case("digits of another script", "12.31", "\uff11\uff12.31", "row 2, column mag: '\uff11\uff12.31'"),
    rows_case("exponent with d", "12.31", "1.231d1", "Write the exponent with e"),
    rows_case("error of 1e-300", "12.31,0.02", "12.31,1e-300", "row 2, column mag_err: 1e-300; expected > 0"),
    rows_case("brighter than a limit", "12.31", "<12.31", "as in >18.5"),
    rows_case(
        "unreadable time", SECOND, "17 Octember 2020 15:10", "row 2, column time: '17 Octember 2020 15:10'"
    ),
    rows_case("blank time", SECOND, "", "row 2, column time: ''"),
    rows_case("date without time", SECOND, "2020-10-17", "a time of day beside the date"),
    rows_case("31 February", SECOND, "2020-02-31T00:00:00", "row 2, column time: '2020-02-31T00:00:00'"),
    rows_case("25 o'clock", SECOND, "2020-10-17T25:00:00", "an existing date and time of day"),
    rows_case("second 60 of any minute", SECOND, "2020-10-17T15:09:60", "an existing date"),
    rows_case("day 367 of a year", SECOND, "2020:367:15:10:00", "a day of the year from 1 to 366"),
    rows_case(
        "local time by name", SECOND, "2020-10-17T23:10:00 CST", "a local time cannot be converted safely"
    ),
    rows_case("offset of 40 h", SECOND, "2020-10-17T15:10:00+40:00", "an offset of at most 14 h"),
    rows_case("before UTC", FIRST, "1957-10-04T19:28:34", "a time in 1960-2200"),
    case_of("MJD as JD", "time_format: mjd", recording="time,mag\n59139.625,12.5\n59139.626,12.4\n"),
    case_of("ISO among JD", "row 2, column time", recording=f"time,mag\n2459140.125,12\n{SECOND},12\n"),
    case_of("JD among ISO", "row 2, column time", recording=f"time,mag\n{SECOND},12\n2459140.125,12\n"),
    case_of(
        "no number",
        "no usable row (2 without a number); expected at least 1 with finite numbers. A row is left out if a cell is blank, NaN or infinite",
        recording=f"time,mag\n{FIRST},\n{SECOND},nan\n",
    ),
    case_of(
        "never above the horizon",
        "column alt: below 0 in 3 rows, which is all that is left",
        scene=ALTAZ_SCENE,
        recording=ALTAZ_RECORDING.replace(",3", ",-3"),
    ),
    case_of(
        "unknown station",
        "'canarias'",
        recording=f"time,mag,station\n{FIRST},12,weihai\n{SECOND},12,canarias\n",
    ),
    case_of(
        "several stations, no column",
        "no column station",
        scene=SCENE.replace("[attitude]", STATION.replace("weihai", "canarias") + "[attitude]"),
    ),
    case_of(
        "negative exposure",
        "column exptime: -1",
        recording=f"time,mag,exptime\n{FIRST},12,-1\n{SECOND},12,1\n",
    ),
    case_of("odd flag", "'maybe'", recording=f"time,mag,upper_limit\n{FIRST},12,maybe\n{SECOND},12,true\n"),
    case_of("vectors wanted", "no column sun_x", scene=VECTOR_SCENE),
    rows_case("no velocity for nadir", "v_x,v_y,v_z", "w_x,w_y,w_z", "no column v_x", VECTOR_RECORDING),
    rows_case(
        "observer at the object", "-36000,-1000,3000", "0,0,0", "a vector of length 0", VECTOR_RECORDING
    ),
    rows_case("no height for alt-az", ",height", ",h", "no column height", ALTAZ_RECORDING),
    rows_case("altitude of 131 deg", "31.0", "131.0", "row 1, column alt: 131", ALTAZ_RECORDING),
    rows_case("negative height", "54.0,550", "54.0,-550", "row 1, column height", ALTAZ_RECORDING),
    rows_case(
        "local time scale", "time_scale: utc", "time_scale: local", "metadata time_scale: 'local'", ECSV
    ),
    rows_case("unknown time scale", "time_scale: utc", "time_scale: lst", "metadata time_scale: 'lst'", ECSV),
    rows_case(
        "unknown time format",
        "time_scale: utc",
        "time_format: stardate",
        "metadata time_format: 'stardate'",
        ECSV,
    ),
    rows_case("ISO said to be JD", "time_scale: utc", "time_format: jd", "row 1, column time", ECSV),
    rows_case(
        "HJD by description", "name: time,", "name: time, description: HJD,", "times at the observer", ECSV
    ),
    rows_case(
        "GPS by description", "name: time,", "name: time, description: GPS time,", "one time scale", ECSV
    ),
    rows_case(
        "start of exposure", "name: time,", "name: time, description: exposure start,", "exptime", ECSV
    ),
    rows_case(
        "local by description", "name: time,", "name: time, description: local time,", "local time", ECSV
    ),
    rows_case(
        "magnitudes in km", "{name: mag, unit: mag", "{name: mag, unit: km", "column mag: unit km", ECSV
    ),
    rows_case(
        "unknown unit", "{name: mag, unit: mag", "{name: mag, unit: magn", "column mag: unit magn", ECSV
    ),
    rows_case("ECSV without types", "# datatype:", "# datatypes:", "unreadable ECSV header", ECSV),
    rows_case(
        "ECSV, other columns", "time mag mag_err\n", "time mag err\n", "as declared: time, mag, mag_err", ECSV
    ),
    rows_case("ECSV, semicolons", "# datatype:", "# delimiter: ;\n# datatype:", "delimiter ';'", ECSV),
    case_of("frames at odds", "ecliptic, but the scene says", scene=VECTOR_SCENE, recording=ECSV_VECTORS),
    rows_case("non-finite rows", "12.31", "nan", "non-finite", outcome="dropped"),
    rows_case("blank cell", "12.31", "", "non-finite", outcome="dropped"),
    rows_case("infinite magnitude", "12.31", "inf", "non-finite", outcome="dropped"),
    rows_case(
        "whole duplicate",
        f"{SECOND},12.31,0.02\n",
        f"{SECOND},12.31,0.02\n" * 2,
        "duplicate",
        outcome="dropped",
    ),
    rows_case("below the horizon", "31.0", "-3.0", "below the horizon", ALTAZ_RECORDING, outcome="dropped"),
    rows_case("out of order", FIRST, "2020-10-17T16:00:00", "have been sorted", outcome="warning"),
    case_of(
        "blank errors", "mag_err, taken as absent", recording=RECORDING.replace("0.02", ""), outcome="warning"
    ),
]
