"""Two vehicles swap places, each in a process of its own, with plans shared over UDP.

Start both with the Unix time at which the flight begins, a few seconds ahead:

    python onboard_udp.py q0 5000 5001 $BEGIN q0.npz &
    python onboard_udp.py q1 5001 5000 $BEGIN q1.npz
"""

from __future__ import annotations

import contextlib
import socket
import sys
import time

import drake_rho as rho

DURATION = 12.0
"""Time of the flight [s]."""


def mission() -> rho.Scenario:
    """Return the mission, which both vehicles know."""
    left, right = rho.State([-4, 0, 1]), rho.State([4, 0, 1])
    return rho.Scenario(
        "swap",
        rho.Grid(step=0.15, knots=21),
        [rho.Vehicle("q0", left, right, radius=0.1), rho.Vehicle("q1", right, left, radius=0.1)],
        rho.Limits(max_speed=6.0, max_acceleration=8.0),
        separation=rho.Separation(0.5),
    )


def arrived(air: socket.socket) -> list[bytes]:
    """Return the messages that have arrived."""
    found = list[bytes]()
    with contextlib.suppress(BlockingIOError):
        while True:
            found.append(air.recv(65_535))
    return found


def main(name: str, own: int, other: int, begin: float, path: str) -> None:
    """Fly one vehicle.

    Args:
        name: of the vehicle.
        own: port on which it hears.
        other: port on which the other vehicle hears.
        begin: Unix time at which the flight begins [s].
        path: file for what the vehicle committed to.
    """
    planner = rho.OnboardPlanner(mission(), name, delay=0.2, latency=0.4)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as air:
        air.bind(("127.0.0.1", own))
        air.setblocking(False)
        while (now := time.time() - begin) < DURATION:
            for data in arrived(air):
                with contextlib.suppress(rho.MessageError):
                    planner.hear(data, now)
            sent = planner.step(now) if now >= 0.0 else None
            if sent is not None:
                air.sendto(sent, ("127.0.0.1", other))
            time.sleep(0.01)  # here an autopilot gets planner.at(now)
    rho.save(planner.flight, path)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4]), sys.argv[5])
