"""Small tables of markers as their programs write them."""

from __future__ import annotations

HEAD = "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames"
TEXTS = {
    "t.trc": f"""PathFileType\t4\t(X/Y/Z)\tt.trc
{HEAD}
100\t100\t3\t2\tmm\t100\t1\t3
Frame#\tTime\tC7\t\t\tLTOE\t\t
\t\tX1\tY1\tZ1\tX2\tY2\tZ2

1\t0.00\t1.5\t2\t3\t4\t5\t6
2\t0.01\t1.5\t2\t3\t\t\t
3\t0.02\t1.5\t2\t3\t4\t5\tNaN
""",
    "motive.csv": """Format Version,1.23,Take Name,"A, b",Capture Frame Rate,120.0,Length Units,Meters

,,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Marker,Marker,Marker
,,"W","W","W","W","W:1","W:1","W:1"
,,Rotation,Position,Position,Position,Position,Position,Position
Frame,Time (Seconds),X,X,Y,Z,X,Y,Z
0,0.000000,1,2,3,4,0.5,0.6,0.7
1,0.008333,1,2,3,4,,,
""",
    "nexus.csv": """Devices
1000
,,F,,
Frame,Sub Frame,Fx,Fy,Fz
,,N,N,N
1,0,1,2,3

Trajectories
100
,,A:C7,,,A:LTOE,,
Frame,Sub Frame,X,Y,Z,X,Y,Z
,,mm,mm,mm,mm,mm,mm
101,0,100,-20,1500,90,15,30
102,0,101,-20,1500,,,
""",
    "qtm.tsv": """NO_OF_FRAMES\t2
NO_OF_MARKERS\t2
FREQUENCY\t200
DATA_INCLUDED\t3D
EVENT\tclap\t2\t0.005
MARKER_NAMES\tC7\tLTOE
1\t0.005\t1\t2\t3\t4\t5\t6
2\t0.010\t1\t2\t3\tnull\tnull\tnull
""",
    "points.csv": "frame,time,C7_x,C7_y,C7_z,C7_error,"
    + ",".join(f"{name}_{axis}" for name in ("LTOE", "LANK", "RANK", "LKNE") for axis in "xyz")
    + """
0,0.00,1.5,2,3,0.5,4,5,6,7,8,9,1,2,3,4,5,7
1,0.01,1.5,2,3,0.5,,,,7,8,9,1,2,4,4,5,8
2,0.02,1.5,2,3,0.5,,,,7,8,9,1,2,5,4,5,9
3,0.03,1.5,2,3,0.5,,,,7,8,9,1,2,6,4,5,9
4,0.04,1.5,2,3,0.5,,,,7,8,9,1,2,6,4,5,9
""",
}
NEXUS_SECTIONS = """Devices
1000
,,Force,,
Frame,Sub Frame,Fx,Fy,Fz
,,N,N,N
1,0,1,2,3
1,1,1,2,3

Events
100
Subject,Context,Name,Time (s),Description
Ann,Left,Foot Strike,1.25,The instant
Ann,Right,Foot Off,broken,

Model Outputs
100
,,Ann:LHipAngles,,
Frame,Sub Frame,X,Y,Z
,,deg,deg,deg
1,0,1,2,3

"""
