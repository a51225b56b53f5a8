"""Options that commands share."""

from pathlib import Path
from typing import Annotated

import typer

Records = Annotated[
    list[Path],
    typer.Argument(
        metavar="[RECORD]...",
        help="Files with decays, runs of one experiment; without any the embedded example runs.",
        show_default=False,
        readable=False,
    ),
]
Time = Annotated[str | None, typer.Option(metavar="COLUMN", help="Time column, by name or number from 0.")]
Angle = Annotated[
    str | None, typer.Option(metavar="COLUMN", help="Angle (or rate) column, by name or number.")
]
Signal = Annotated[str, typer.Option(metavar="angle|rate", help="What was measured.")]
Units = Annotated[
    str | None, typer.Option(metavar="rad|deg", help="Unit of the angle; default: the header's, or rad.")
]
Rate = Annotated[
    float | None, typer.Option(metavar="HZ", help="Sampling rate, where there is no time column.")
]
TimeUnits = Annotated[
    str | None, typer.Option(metavar="s|ms|us|min", help="Unit of time; default: the header's, or s.")
]
Window = Annotated[
    str, typer.Option(metavar="START:STOP", help="Part of the record in s; either side may be empty.")
]
Equilibrium = Annotated[
    str, typer.Option(metavar="VALUE|auto", help="Equilibrium angle, in the unit of the record's column.")
]
Library = Annotated[str, typer.Option(metavar="NAME|FILE", help="Force library.")]
Forces = Annotated[str | None, typer.Option(metavar="A,B,...", help="Symbols of the forces to identify.")]
Omega0 = Annotated[
    str | None, typer.Option(metavar="VALUE[±ERROR]", help="Frequency without contact (rad/s): adds alpha.")
]
Reference = Annotated[
    float | None, typer.Option(metavar="RAD/S", help="Reference frequency, held; default: fitted.")
]
Inertia = Annotated[
    float | None, typer.Option(metavar="KG*M^2", help="Moment of inertia: coefficients in SI units too.")
]
Shapes = Annotated[
    list[str], typer.Option("--set", metavar="SYMBOL.SHAPE=VALUE", help="A shape parameter to hold; repeat.")
]
Fixes = Annotated[
    list[str], typer.Option(metavar="NAME=VALUE", help="A coefficient or shape to hold: lambda=0; repeat.")
]
Bounds = Annotated[
    list[str], typer.Option(metavar="NAME=LOW:HIGH", help="Bounds of one; either may be empty: zeta=0:.")
]
Ties = Annotated[
    list[str], typer.Option(metavar="NAME=FORMULA", help='One by others: "nu=-2.356*delta"; repeat.')
]
Output = Annotated[Path | None, typer.Option("-o", "--output", metavar="FILE", help="Where to write.")]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON, and nothing else.")]
Plot = Annotated[Path | None, typer.Option(metavar="DIR", help="Folder for the figures (PDF and PNG).")]
Explain = Annotated[bool, typer.Option("--explain", help="Print all that was tested, and what follows.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="Print the verdict and the table alone.")]
