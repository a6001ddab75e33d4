"""Reads a recording with the independent `mcap` and `mcap-ros2-support` packages, through its index."""

import sys

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

with open(sys.argv[1], "rb") as file:
    reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
    decoded = [(channel.topic, message) for _, channel, _, message in reader.iter_decoded_messages()]
states = [m for topic, m in decoded if topic == "sinew/paper/state"]
events = [m for topic, m in decoded if topic == "sinew/paper/events"]
last = states[-1]
print(
    len(states),
    len(last.tension_command_n),
    last.tension_command_n[-1],
    last.nodes[-1].position_m[0],
    events[0].text,
    last.obstacle_sources[0].source_id,
)
