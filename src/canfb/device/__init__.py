"""A CiA 301 slave without I/O: frames and times in, frames and the next deadline out."""
