"""The bench window: one Qt window in which a person does a whole experiment."""
