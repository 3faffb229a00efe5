"""Fitting while a run goes on."""
