"""Content of rosbag2's information file, and of a folder by the readers of `rosbags`."""

import yaml
from rosbags.rosbag2 import Reader


def information(folder):
    return yaml.safe_load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]


def rosbags_times(path):
    with Reader(path) as reader:
        return [time_ns for _, time_ns, _ in reader.messages()]
