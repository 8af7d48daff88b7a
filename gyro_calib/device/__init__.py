"""What a gyro is: resonator, drive and pick-off chains, electronics, noise; YAML in and out; drawn units."""

from .chains import DriveChain, Feedthrough, PickoffChain
from .device import Device, FactoryData, SlowFlow
from .draw import Spread, draw_unit
from .electronics import Electronics, Environment, Loops, Multiplexing, Noise
from .io import device_from_dict, device_to_dict, dump_device, load_device
from .resonator import BOLTZMANN_J_PER_K, J, Nonlinearity, Resonator, azimuth_matrix

__all__ = [
    "BOLTZMANN_J_PER_K",
    "Device",
    "DriveChain",
    "Electronics",
    "Environment",
    "FactoryData",
    "Feedthrough",
    "J",
    "Loops",
    "Multiplexing",
    "Noise",
    "Nonlinearity",
    "PickoffChain",
    "Resonator",
    "SlowFlow",
    "Spread",
    "azimuth_matrix",
    "device_from_dict",
    "device_to_dict",
    "draw_unit",
    "dump_device",
    "load_device",
]
