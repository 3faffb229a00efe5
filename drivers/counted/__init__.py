"""Pumps that count what they deliver, and a file that remembers what the count means.

Shared by the drivers of pumps whose firmware knows no absolute target, no dose number and no latch.
"""
