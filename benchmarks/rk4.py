"""The paper's method, as `jaxvibro.paper` measures it too."""

from benchmarks.work import CAP, GAMMA, OMEGA, RESTITUTION, Strobes
from jaxvibro.reproduction import fixed_step

DRIVE = fixed_step.DriveParameters(OMEGA, GAMMA, RESTITUTION)


def strobe(states, steps=400):
    """Map (n, 3) states x, x', A through one period in the given number of steps a period; returns Strobes."""
    return Strobes(*fixed_step.fixed_step_strobe(DRIVE, states, steps, max_impacts=CAP))
