"""The encoder profile CiA 406: its objects, alarms and warnings."""
