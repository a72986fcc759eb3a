"""The return matrix: after every fault the outputs become VALID again within their bounds."""
