"""What every command of the package does alike: as the commands of the nodes' packages do."""

from ship_node.command_line import EXIT_BAD_INPUT as EXIT_BAD_INPUT
from ship_node.command_line import EXIT_BOUND_NOT_MET as EXIT_BOUND_NOT_MET
from ship_node.command_line import EXIT_DONE as EXIT_DONE
from ship_node.command_line import CommandParser as CommandParser
from ship_node.command_line import run_command as run_command
