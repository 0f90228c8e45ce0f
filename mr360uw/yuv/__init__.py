# SPDX-License-Identifier: Apache-2.0
"""The Y'CbCr decoder: code values of a frame's planes -> R'G'B' -> linear light.

coefficients     offsets, spans and matrix of a plate, tables and polynomial of its transfer curve (numpy alone)
file_profile     the map that a picture file names: an ICC profile, or chromaticities and a curve
ocio_transform   colour spaces and tables (.cube) of OpenColorIO as such a mapping
decoding         linear light of a rectangle, or in directions; the compiled functions that every pixel loop over
                 planes is made of
"""
