"""The paper's method, as `jaxvibro.paper` measures it too."""

from benchmarks.work import CAP, GAMMA, OMEGA, RESTITUTION, Strobes
from jaxvibro.reproduction import stepped

DRIVE = stepped.Drive(OMEGA, GAMMA, RESTITUTION)


def strobe(states, steps=400):
    """Map (n, 3) states x, x', A through one period in the given number of steps a period; returns Strobes."""
    return Strobes(*stepped.strobe(DRIVE, states, steps, room=CAP))
