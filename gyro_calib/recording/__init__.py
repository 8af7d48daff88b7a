"""What a gyro did under known commands: columns, commands, recordings, their files and bags, and what makes them refusable."""

from typing import TYPE_CHECKING

from ..later import loaded_later
from .columns import CHANNELS, COLUMN_UNITS, COLUMNS, column_index
from .command import EXCITATIONS, MODES, Command, Excitation, Setpoints
from .demodulate import demodulate
from .integrity import check_rows, validate
from .rate import raw_rate
from .recording import Campaign, Recording

if TYPE_CHECKING:
    from .bag import read_campaign_bag
    from .bag_writer import write_campaign_bag
    from .hdf5 import read_campaign_h5, write_campaign_h5
    from .load import load_campaign

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

# what needs HDF5, for those who have no files
__getattr__ = loaded_later(
    __name__,
    {
        "load_campaign": "load",
        "read_campaign_bag": "bag",
        "read_campaign_h5": "hdf5",
        "write_campaign_bag": "bag_writer",
        "write_campaign_h5": "hdf5",
    },
)
