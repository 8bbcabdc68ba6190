"""PDOs (CiA 301, 7.2.2): parameters, mapping, receiving and sending."""
