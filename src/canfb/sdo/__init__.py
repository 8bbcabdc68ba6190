"""What the commands sdo, table and backup do."""
