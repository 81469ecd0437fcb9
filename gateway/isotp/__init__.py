"""ISO-TP (ISO 15765-2): frames in, messages out; messages in, frames out. It knows neither servers nor clients."""
