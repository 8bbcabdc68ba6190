"""Limits and margins of bit rate, SYNC rate, encoder and motion: pure arithmetic."""
