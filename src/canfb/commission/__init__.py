"""``canfb commission``: limits of the supervision from a machine in its duty.

From samples to limits that are written, watched and saved::

    commission_run      from the first sample to the last file
    machine_seen        what samples show of a machine: motion_seen, signal_seen
    limit_choice        the limits that follow, each with its reason
    commission_summary  figures for people and programs; commission_page: the page
"""
