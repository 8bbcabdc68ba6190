"""The claims of the paper, tried one by one."""
