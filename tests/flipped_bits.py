"""Damage to files."""


def flipped(content, place):
    """Bytes with one bit flipped, counted from the first byte's lowest."""
    byte, bit = divmod(place, 8)
    return content[:byte] + bytes([content[byte] ^ 1 << bit]) + content[byte + 1 :]
