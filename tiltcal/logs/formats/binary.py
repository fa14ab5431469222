"""Files that are no text, by what they begin with, and how rows in CSV come out of them."""

from __future__ import annotations

from tiltcal.errors import InputError

_PYTHON = "in Python: pandas.DataFrame({of}).to_csv('log.csv', index=False)"

KINDS: tuple[tuple[bytes, str, str], ...] = (
    (b"PK\x03\x04", "a ZIP archive, as Excel's .xlsx and ActiGraph's .gt3x are", "save the sheet as CSV, or unpack it"),
    (b"\xd0\xcf\x11\xe0", "an Excel file (.xls)", "save the sheet as CSV"),
    (b"MATLAB 5.0", "a MATLAB file (.mat)", "in MATLAB: writematrix(data, 'log.csv')"),
    (b"\x93NUMPY", "an array of numpy (.npy)", _PYTHON.format(of="numpy.load('log.npy')")),
    (b"MD", "a recording of an Axivity sensor (.cwa)", "convert it with cwa-convert or OmGui to CSV"),
    (b"TDSm", "a TDMS file of LabVIEW", _PYTHON.format(of="nptdms.TdmsFile('log.tdms').as_dataframe()")),
    (b"\x89HDF", "an HDF5 file", "if it is NetCDF-4, name it .nc; else write its columns as CSV"),
    (b"CDF", "a NetCDF-3 file", "make NetCDF-4 of it, such as with nccopy -k nc4 OLD NEW.nc"),
    (b"PAR1", "a Parquet file", "name it .parquet"),
    (b"ARROW1", "a file of Arrow (.feather)", "write it as Parquet or CSV"),
    (b"\x89MCAP", "a bag of ROS (MCAP)", "name it .mcap"),
    (b"#ROSBAG", "a bag of ROS 1", "name it .bag"),
    (b"SQLite format 3", "an SQLite database", "sqlite3 -header -csv FILE 'select * from TABLE' > log.csv"),
    (b"\x1f\x8b", "packed by gzip", "unpack it: zcat FILE | tiltcal ... -"),
    (b"BZh", "packed by bzip2", "unpack it: bzcat FILE | tiltcal ... -"),
    (b"\xfd7zXZ", "packed by xz", "unpack it: xzcat FILE | tiltcal ... -"),
    (b"(\xb5/\xfd", "packed by zstd", "unpack it: zstdcat FILE | tiltcal ... -"),
    (b"7z\xbc\xaf", "a 7-Zip archive", "unpack it"),
    (b"%PDF", "a PDF", "export the log from the program that made it as CSV"),
    (b"RIFF", "a sound file (RIFF)", "write its samples as CSV"),
    (b"ULog", "a log of PX4 (.ulg)", "ulog2csv FILE"),
    (b"\xa3\x95\x80", "a log of ArduPilot (.bin)", "mavlogdump.py --format csv --types IMU FILE > log.csv"),
    (b"<?xml", "XML", "export the log as CSV"),
    (b"\x80\x04\x95", "a pickle of Python", "write its columns as CSV"),
)
"""What a file begins with, what it is, and what to do."""

_TEXT = 0.02  # the largest share of control characters in a text


def refuse_binary(head: bytes, file: str) -> None:
    """Raise an InputError for the first bytes of a file that is no text."""
    for magic, what, how in KINDS:
        named = head.startswith(magic)
        if named and (len(magic) > 2 or b"\0" in head[:512] or not head[:512].isascii()):
            raise InputError(f"this is {what}, no text: {how}", file=file)
    some = head[:4096]
    control = sum(some.count(code) for code in range(1, 32) if code not in b"\t\n\r\f\x1a\x1b")
    if len(some) >= 64 and control > _TEXT * len(some) and some.count(0):
        raise InputError("this is no text: export the log as CSV from the program that made it", file=file)
