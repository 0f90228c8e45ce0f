# SPDX-License-Identifier: Apache-2.0
"""The Y'CbCr decoder: code values of a frame's planes -> R'G'B' -> linear light.

coefficients     offsets, spans and matrix of a plate, tables and polynomial of its transfer curve (numpy alone)
wide_curves      transfer curves that hold light above white, of colour-science
decode_kernels   the compiled functions that every pixel loop over planes is made of
decoding         linear light of a rectangle, or in directions
"""
