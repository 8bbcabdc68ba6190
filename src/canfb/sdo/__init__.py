"""The commands sdo, table and backup."""
