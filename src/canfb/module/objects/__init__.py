"""The manufacturer objects: 2000h, 2011h to 2013h, 2020h, 2030h, 2050h."""
