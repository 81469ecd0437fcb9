"""OBD on CAN (SAE J1979, ISO 15031-5, ISO 15765-4): modes 01 02 03 04 06 07 09 0A over the fault memory."""
