"""`Frame`: the place on the Earth where a scenario's axes begin."""

from __future__ import annotations

from typing import Annotated

import numpy as np
import numpy.typing as npt
from pydantic import Field

from drake_rho.scenario.fields import NOT_BOOLEAN, FloatArray, record
from drake_rho.scenario.libraries import library

EARTH_RADIUS = 6_371_000.0
"""Mean radius of the Earth [m]."""
_WHY = "missions"


@record
class Frame:
    """Place of a scenario's origin on the Earth (WGS 84); x is east, y north, z up there.

    Altitudes are above mean sea level, and are taken as heights above the ellipsoid: the difference
    is nearly constant within a flight, and changes horizontal distances by 16 mm in a kilometre at
    most.

    Examples:
        >>> home = rho.Frame(47.3977, 8.5456, 488.0)
        >>> home.local(47.3986, 8.5456, 488.0).round(1).tolist()
        [0.0, 100.1, -0.0]
        >>> home.geodetic([0.0, 0.0, 10.0]).round(6).tolist()
        [47.3977, 8.5456, 498.0]
    """

    latitude: Annotated[float, Field(ge=-90.0, le=90.0, allow_inf_nan=False), NOT_BOOLEAN]
    """latitude [degrees], positive to the north"""
    longitude: Annotated[float, Field(ge=-180.0, le=180.0, allow_inf_nan=False), NOT_BOOLEAN]
    """longitude [degrees], positive to the east"""
    altitude: Annotated[float, Field(ge=-1e5, le=1e5, allow_inf_nan=False), NOT_BOOLEAN] = 0.0
    """altitude above mean sea level [m]"""

    def __str__(self) -> str:
        """Return a description: 'latitude 47.4°, longitude 8.5°, altitude 488 m'."""
        place = f"latitude {self.latitude:.7g}°, longitude {self.longitude:.7g}°"
        return f"{place}, altitude {self.altitude:g} m"

    def local(
        self, latitude: npt.ArrayLike, longitude: npt.ArrayLike, altitude: npt.ArrayLike
    ) -> FloatArray:
        """Return the positions of places on the Earth, east, north and up [m], shape (..., 3).

        Args:
            latitude: latitudes [degrees], shape (...).
            longitude: longitudes [degrees], shape (...).
            altitude: altitudes above mean sea level [m], shape (...).

        Raises:
            ScenarioError: the extra `missions` is not installed.
        """
        given = (np.asarray(each, dtype=np.float64) for each in (latitude, longitude, altitude))
        origin = self.latitude, self.longitude, self.altitude
        return np.stack(library("pymap3d", _WHY).geodetic2enu(*given, *origin), axis=-1)

    def geodetic(self, positions: npt.ArrayLike) -> FloatArray:
        """Return latitudes, longitudes [degrees] and altitudes [m] of positions, shape (..., 3).

        Args:
            positions: east, north and up of the origin [m], shape (..., 3).

        Raises:
            ScenarioError: the extra `missions` is not installed.
        """
        enu = np.moveaxis(np.asarray(positions, dtype=np.float64), -1, 0)
        origin = self.latitude, self.longitude, self.altitude
        return np.stack(library("pymap3d", _WHY).enu2geodetic(*enu, *origin), axis=-1)
