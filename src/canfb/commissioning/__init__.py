"""Setting a module up over the bus: reference measurement, upload of its table, proof, report.

The master's side, between the buses and the calculation::

    samples            what was recorded; sample_files: NPZ
    listening          samples of the ADC PDO, SYNC by SYNC; pdo_layout: which PDO it is
    recording_upload   samples of object 2050h of either node
    own_calibration    the module's own reference measurement, object 2030h
    active             table and conditioning: read, activate, restore, save
    deviation          how good a table is on samples that it has not seen
    measurement        samples in, a table out, compared with the one before
    procedure          table activated, verified and saved; guard: nothing half done
    choices            what canfb calibrate is asked to do; combinations: options that exclude each other
    calibration_run    the command, from the first sample to the last file
    drift_check        how far an encoder has moved away from its table; drift_summary: its figures
    session            both nodes on a bus, read once
    module_objects     the objects of a module, for its configuration
    circumstances      provenance of a measurement: nodes, date, command
    summary            figures for people; calibration_page: the page, from canfb.report
    artefacts          the files of a measurement; table_file: tables as YAML
    commission_run     canfb commission: from the first sample to the last file; commission_summary,
                       commission_page: its account; machine_watch: what the module says meanwhile
    machine_seen       what samples show of a machine: motion_seen, converter_noise; supervised_samples: the
                       chain of the module on them
    limit_choice       the limits that follow; supervision_limits: 2001h and 2010h; limit_setting: written,
                       watched, saved
    table_tasks        canfb table: upload, activation and the rest; table_state: how it stands
    backup_file        canfb backup: all parameters as YAML; backup_restoring: back into a module, proven;
                       backup_words: what is said of both
    object_description what an EDS says of the objects; object_values: their values as people write them
    sdo_tasks          canfb sdo: one object by name; object_words: bits, enumerations, abort codes
    undoing            a change as a whole or not at all; whole_file: the same for files
    marked_yaml        YAML with the lines of its keys, for messages

``access.Master`` is what it needs of a bus: frames, an SDO client, a clock and a means to wait;
``access.NodeAccess`` reads and writes the objects of a node, long ones by domain_transfer.
"""
