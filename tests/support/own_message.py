"""A database of one message, for logs that tests make."""

DBC = """VERSION ""
NS_ :
BS_:
BU_: A B
BO_ 256 M0: 8 A
 SG_ Value : 0|16@1+ (0.5,0) [0|32767] "V" B
"""
