"""The return matrix: after every fault the outputs are VALID again within their bounds, by themselves."""
