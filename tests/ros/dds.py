"""A DDS domain for one test: on loopback, without multicast, and not to be mixed up with any other."""

from __future__ import annotations

import os
import uuid

DOMAIN = 1 + os.getpid() % 99  # the ports of higher ones lie in the range of ephemeral ports


def cyclonedds_uri(tag: str | None = None) -> str:
    """For $CYCLONEDDS_URI. tag: only participants of the same one see each other."""
    return f"""<CycloneDDS><Domain>
        <General>
            <Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces>
            <AllowMulticast>false</AllowMulticast>
        </General>
        <Discovery>
            <Tag>{tag or uuid.uuid4().hex}</Tag>
            <ParticipantIndex>auto</ParticipantIndex>
            <MaxAutoParticipantIndex>20</MaxAutoParticipantIndex>
            <Peers><Peer Address="127.0.0.1"/></Peers>
        </Discovery>
    </Domain></CycloneDDS>"""
