"""What a user may have meant: numbers that are right as they stand, and yet look as if they were in other units."""

import warnings

import numpy as np

NEAR = (0.4, 2.5)  # of the natural frequency: what is so near once it is taken for Hz looks like Hz
FAR = 20.0  # times what the mass reaches: a wall as far away looks like one in mm
MILLI = 1e-3


def ask(scene, in_radians, damping_ratio=None, gap=None):
    """Warn, once, where the frequency given in radians per second looks like Hz, the walls' positions like mm, the
    damping ratio like per cent, or a gap like a position, of a single scene."""
    frequency = float(scene.frequency)
    found = []
    looks_like_hz = in_radians and NEAR[0] <= 2.0 * np.pi * frequency <= NEAR[1]
    if looks_like_hz:
        told = f"the drive is at {frequency:.3g} of the natural frequency, and would be at"
        found.append(f"is the frequency in Hz ({told} {2.0 * np.pi * frequency:.3g})? frequency_hz= takes it so")
    meant = 2.0 * np.pi * frequency if looks_like_hz else frequency
    far = [abs(float(wall.position)) for wall in scene.walls.values() if wall.motion is None]
    reached = float(scene.amplitude) / abs(1.0 - meant**2 + 2j * float(scene.damping) * meant) if meant != 1 else np.inf
    if len(far) == len(scene.walls) and far and reached > 0 and min(far) > FAR * reached >= FAR * MILLI * min(far):
        times = f"{min(far) / reached:.3g} times as far as the drive moves the mass"
        found.append(f"are the walls' positions in mm (they are {times})? they are taken in m")
    if damping_ratio is not None and float(damping_ratio) > 1.0:
        found.append(f"is the damping ratio in per cent ({float(damping_ratio):g})? 1 is critical")
    if isinstance(gap, tuple | list) and any(one is not None and float(one) < 0 for one in gap):
        found.append(
            f"is gap ({', '.join(map(str, gap))}) meant as positions? walls= takes them; a gap counts outwards"
        )
    if found:
        warnings.warn("; ".join(found), UserWarning, stacklevel=4)


def ask_of_record(scene, record):
    """Warn where a record's times look like seconds: it is to cover less than a drive period of a scene with scales."""
    turns = float(np.ptp(record.times)) * float(scene.frequency) / (2.0 * np.pi)
    if scene.scales is not None and turns < 1.0:
        told = f"the record covers {turns:.2g} of a drive period: are its times in seconds?"
        warnings.warn(f"{told} record_from_physical takes them so", UserWarning, stacklevel=4)
