"""Reads what a recording has for viewers with the independent `mcap` and `mcap-protobuf-support` packages."""

import json
import struct
import sys

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

with open(sys.argv[1], "rb") as file:
    reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
    topics = [f"sinew/paper/{name}" for name in ("scene", "transforms", "log", "points")]
    messages = {topic.rsplit("/", 1)[1]: [] for topic in topics}
    for schema, channel, _, message in reader.iter_decoded_messages(topics=topics):
        assert schema.name.startswith("foxglove."), schema.name
        messages[channel.topic.rsplit("/", 1)[1]].append(message)
    attachments = {attachment.name: attachment.data.decode() for attachment in reader.iter_attachments()}

scene = messages["scene"][-1]
arm = next(entity for entity in scene.entities if entity.id == "arm")
ball = next(entity for entity in scene.entities if entity.spheres and entity.id.startswith("obstacle"))
cloud = messages["points"][-1]
print(
    json.dumps(
        {
            "counts": {name: len(found) for name, found in messages.items()},
            "entities": [entity.id for entity in scene.entities],
            "deleted": [deletion.id for update in messages["scene"] for deletion in update.deletions],
            "disks": len(arm.cylinders),
            "backbone": len(arm.lines[0].points),
            "tip": [arm.lines[0].points[-1].x, arm.lines[0].points[-1].z],
            "ball": [ball.spheres[0].pose.position.x, ball.spheres[0].size.x],
            "label": ball.texts[0].text,
            "frames": [transform.child_frame_id for transform in messages["transforms"][-1].transforms],
            "log": [(entry.level, entry.message) for entry in messages["log"]],
            "first_point": struct.unpack("<3f", cloud.data[:12]),
            "points": len(cloud.data) // cloud.point_stride,
            "version": json.loads(attachments["software.json"])["version"],
            "segments": len(json.loads(attachments["settings.json"])["segments"]),
            "configuration": attachments["configuration.toml"],
        }
    )
)
