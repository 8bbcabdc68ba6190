"""The SDO server (CiA 301, 7.2.4): expedited, segmented and block transfer."""
