"""Experiments of Huffman's document."""
