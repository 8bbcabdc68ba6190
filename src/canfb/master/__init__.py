"""The master's side of tools: a node's objects by SDO, samples over the bus, changes that are undone.

``access.Master`` is what it needs of a bus: frames, an SDO client, a clock and a means to wait;
``access.NodeAccess`` reads and writes the objects of a node. What several commands share is here::

    access              objects of a node by SDO
    node_state          NMT state, boot-up, restart at standstill
    all_or_nothing      table and conditioning; a change as a whole or not at all
    listening           samples of the ADC PDO, SYNC by SYNC, and of object 2050h of either node
    samples             what was recorded, also as NPZ and CSV
    session             both nodes on a bus, read once, and the PDO on which both agree
    supervision_limits  2001h and 2010h: read, written
    machine_watch       speed, status and counters during a measurement; its provenance
"""
