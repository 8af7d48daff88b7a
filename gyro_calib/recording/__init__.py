"""What a gyro did under known commands: columns, commands, recordings, their files and bags, and what makes them refusable."""

from .bag import read_campaign_bag
from .bag_writer import write_campaign_bag
from .columns import CHANNELS, COLUMN_UNITS, COLUMNS, column_index
from .command import EXCITATIONS, MODES, Command, Excitation, Setpoints
from .demodulate import demodulate
from .hdf5 import read_campaign_h5, write_campaign_h5
from .integrity import check_rows, validate
from .load import load_campaign
from .rate import raw_rate
from .recording import Campaign, Recording

__all__ = [
    "CHANNELS",
    "COLUMNS",
    "COLUMN_UNITS",
    "EXCITATIONS",
    "MODES",
    "Campaign",
    "Command",
    "Excitation",
    "Recording",
    "Setpoints",
    "check_rows",
    "column_index",
    "demodulate",
    "load_campaign",
    "raw_rate",
    "read_campaign_bag",
    "read_campaign_h5",
    "validate",
    "write_campaign_bag",
    "write_campaign_h5",
]
