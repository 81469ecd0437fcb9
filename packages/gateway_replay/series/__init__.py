"""Values that monitors compute, over time: gathered beside a running gateway, written to files, read again.

``gather`` looks at the engine after each frame and each timer and changes nothing in it; ``files`` has the formats;
``envelope`` keeps as much of it as a picture can show.
"""
