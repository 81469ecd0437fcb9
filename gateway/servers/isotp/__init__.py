"""ISO-TP (ISO 15765-2) below a server: frames in, requests out; responses in, frames out. It knows no server."""
