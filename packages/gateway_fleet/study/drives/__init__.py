"""What is learned of one drive, judged on other drives of the same vehicle, healthy and with everyday faults."""
