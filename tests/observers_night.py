"""Three measurements of one night as files have them, in our names and in those of others."""

from __future__ import annotations

import astropy.units as u
import numpy as np
from astropy.time import Time

from torchlc.readers import Recording

JD = [2459140.125, 2459140.135, 2459140.145]
MAG, ERROR = [14.908, 14.793, 14.732], [0.03, 0.02, 0.04]


def table(names: str, *, zero: float = 0.0, mark: str = ",", more: str = "", comma: bool = False) -> str:
    """A table of the three measurements with these names, Julian dates from ``zero``; ``more`` ends each row."""
    rows = [
        f"{jd - zero:.6f}{mark}{mag}{mark}{error}{more}"
        for jd, mag, error in zip(JD, MAG, ERROR, strict=True)
    ]
    text = "\n".join(rows)
    return names + "\n" + (text.replace(".", ",") if comma else text) + "\n"


def holds(recording: Recording, *, error: bool = True) -> None:
    """The three measurements; a date of six decimals is good to 0.05 s."""
    assert recording.kind == "mag" and recording.observed.tolist() == MAG
    assert not error or (recording.error is not None and recording.error.tolist() == ERROR)
    assert np.abs((recording.time - Time(JD, format="jd", scale="utc")).to_value(u.s)).max() < 0.05


AIJ = "\tLabel\tslice\tJD-2400000\tJD_UTC\tBJD_TDB\tAIRMASS\tEXPTIME\tSource_AMag_T1\tSource_AMag_Err_T1\tSource_AMag_C2\n" + "".join(
    f"{k}\timg_{k}.fits\t1\t{jd - 2400000:.6f}\t{jd:.6f}\t{jd + 0.005:.6f}\t1.3\t10.0\t{mag}\t{error}\t12.0\n"
    for k, (jd, mag, error) in enumerate(zip(JD, MAG, ERROR, strict=True), 1)
)  # fmt: skip
EXPORTS = {
    "AstroImageJ, tabs": AIJ,
    "AstroImageJ, commas": AIJ.replace("\t", ","),
    "ZTF": table("mjd,mag,magerr,filter", zero=2400000.5, more=",zr"),
    "reduced dates": table("JD-2400000,Mag,Err", zero=2400000.0),
    "blanks": table("JD     Mag    Err", mark="   "),
    "semicolons": table("JD;Mag;Err", mark=";"),
    "semicolons, decimal commas": table("Zeit;Helligkeit;Fehler", mark=";", comma=True),
    "tabs, decimal commas": table("JD\tmagnitude\tmag_error", mark="\t", comma=True),
    "bars": table("JD|Mag|MagErr", mark="|"),
    "names in a comment": table("# JD Mag Err", mark=" "),
    "a magnitude called by its filter, below lines with commas": "Observer: Me, Location: Here\nComp star mag 12.1, 0.02\n\n\n"
    + table("JD,V,err"),
    "a filter in brackets": table("JD,Mag (V),Err"),
    "errors called std": table("JD,mag,std"),
    "comments with ;": "; Observer: A. B.\n; Filter: V\n" + table("JD,Mag,Err"),
    "comments with %": "% made by a script\n" + table("JD,Mag,Err"),
    "prose above": "Light curve of the object\nTelescope 0.3 m, f/5\n\n" + table("Julian Date,Magnitude,Uncertainty"),
    "units below the names": table("JD,Mag,Err\n(d),(mag),(mag)"),
    "brackets in names": table("JD (UTC),Mag [mag],Mag Err [mag]"),
    "no names": table("# of last night"),
    "capitals": table("TIME,MAG,MAG_ERR"),
    "MPO Canopus": table("JD;ObjMag;ObjErr;CompMag", mark=";", more=";12.0"),
    "MPO Canopus, lines above the names": "Object: SAT 1\nFilter: V\n\n" + table("JD   ObjMag   ObjErr", mark="   "),
    "ZTF alerts": table("jd,magpsf,sigmapsf,fid", more=",2"),
    "ZTF of a broker": table("MJD,unforced_mag,unforced_mag_error,filter", zero=2400000.5, more=",g"),
    "French": table("Jour Julien;Magnitude;Erreur", mark=";", comma=True),
    "Italian": table("Giorno Giuliano;Magnitudine;Errore", mark=";", comma=True),
    "Spanish": table("Fecha juliana;Magnitud;Error", mark=";", comma=True),
    "German dates": "Datum;Zeit;Helligkeit;Fehler\n"
    + "".join(f"17.10.2020;{Time(jd, format='jd').isot[11:]};{mag};{error}\n" for jd, mag, error in zip(JD, MAG, ERROR, strict=True)),
    "Tycho Tracker": table("JD,Target Mag,Target Mag Err,SNR", more=",40"),
    "AAVSO": "#TYPE=Extended\n#OBSCODE=ABC\n#SOFTWARE=x\n#DELIM=,\n#DATE=JD\n#OBSTYPE=CCD\n"
    "#NAME,DATE,MAG,MERR,FILT,TRANS,MTYPE,CNAME,CMAG,KNAME,KMAG,AMASS,GROUP,CHART,NOTES\n"
    + "".join(f"SAT 1,{jd:.6f},{mag},{error},V,NO,STD,ENSEMBLE,na,na,na,1.2,na,na,na\n" for jd, mag, error in zip(JD, MAG, ERROR, strict=True)),
    "SCORE": "satellite_name,norad_cat_id,observation_time_utc,observation_time_uncertainty_sec,apparent_magnitude,"
    "apparent_magnitude_uncertainty,observer_latitude_deg,observer_longitude_deg,observer_altitude_m,limiting_magnitude,"
    "instrument,observing_filter\n"
    + "".join(f"SAT 1,12345,{Time(jd, format='jd').isot}Z,0.1,{mag},{error},37.54,122.05,110,,cam,V\n" for jd, mag, error in zip(JD, MAG, ERROR, strict=True)),
    "ATLAS": "###MJD m dm uJy duJy F err chi/N RA Dec x y maj min phi apfit mag5sig Sky Obs\n"
    + "".join(f"{jd - 2400000.5 - 15 / 86400:.6f} {mag} {error} 100 2 o 0 1 1 1 1 1 3 3 1 -0.4 19.5 20 x\n" for jd, mag, error in zip(JD, MAG, ERROR, strict=True)),
    "SExtractor": table("JD,MAG_AUTO,MAGERR_AUTO"),
    "ADES": "# version=2017\n# observatory\n! mpcCode B01\npermID|mode|stn|obsTime|ra|dec|mag|rmsMag|band\n"
    + "".join(f"433|CCD|B01|{Time(jd, format='jd').isot}Z|10.1|20.2|{mag}|{error}|V\n" for jd, mag, error in zip(JD, MAG, ERROR, strict=True)),
    "AAVSO download": table("JD,Magnitude,Uncertainty,HQuncertainty,Band,Observer Code", more=",,V,XYZ"),
    "dates with strokes, no names": "".join(f"{Time(jd, format='jd').strftime('%d/%m/%Y %H:%M:%S')},{mag},{error}\n" for jd, mag, error in zip(JD, MAG, ERROR, strict=True)),
    "a date with a share of the day": "UT Date;Mag;Err\n"
    + "".join(f"2020-10-{17 + jd - 2459139.5:.6f};{mag};{error}\n" for jd, mag, error in zip(JD, MAG, ERROR, strict=True)),
    "dates and times in digits": "date;time;mag;err\n"
    + "".join(f"{Time(jd, format='jd').strftime('%Y%m%d;%H%M%S')};{mag};{error}\n" for jd, mag, error in zip(JD, MAG, ERROR, strict=True)),
    "date and time in German": "Datum/Zeit UT;Helligkeit (mag);Fehler (mag)\n"
    + "".join(f"{Time(jd, format='jd').strftime('%d.%m.%Y %H:%M:%S')};{mag};{error}\n" for jd, mag, error in zip(JD, MAG, ERROR, strict=True)),
    "local times with their offset": "Local Time,Mag,Err\n"
    + "".join(f"{Time(jd + 2 / 24, format='jd').isot}+02:00,{mag},{error}\n" for jd, mag, error in zip(JD, MAG, ERROR, strict=True)),
    "date and time apart": "Date,UT,Mag,Err\n"
    + "".join(f"{Time(jd, format='jd').isot.replace('T', ',')},{mag},{error}\n" for jd, mag, error in zip(JD, MAG, ERROR, strict=True)),
}  # fmt: skip
