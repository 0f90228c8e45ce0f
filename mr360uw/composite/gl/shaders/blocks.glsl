// Numbering of lists and of pixels in blocks of 4 x 4, and the members of a list that may cover a pixel. Targets hold
// numbered items in blocks of 4 x 4 texels, because software drivers draw such blocks at once. Held to
// composite/gl/triangles.py.
const int LANE_COLUMNS = 256;
const int MASKS_AT_ONCE = 6;
const int MEMBERS_AT_ONCE = 4 * MASKS_AT_ONCE;

int lane_number(ivec2 at) {
    return (((at.y >> 2) * (LANE_COLUMNS >> 2) + (at.x >> 2)) << 4) + ((at.y & 3) << 2) + (at.x & 3);
}

// texel of an entry of a list in rows of 2048: shifts, because software drivers divide integers one lane at a time
ivec2 list_place(int index) {
    return ivec2(index & 2047, index >> 11);
}

// column and row of a pixel within its block
ivec2 place_in_block(int number) {
    return ivec2(number & 3, (number >> 2) & 3);
}

// bits of the members [first, end) of a list that may cover a pixel, counted from the multiple of 4 at or below
// `first`; MEMBERS_AT_ONCE of them
int members_of_pixel(sampler2D masks, int first, int end, int pixel) {
    int wanted = 0, from = first & ~3, bit = 1 << (pixel & 15);
    for (int k = 0; k < MASKS_AT_ONCE; ++k) {
        ivec4 mask = ivec4(texelFetch(masks, list_place(min((from >> 2) + k, (end - 1) >> 2)), 0));
        for (int j = 0; j < 4; ++j) {
            int member = from + 4 * k + j;
            if ((mask[j] & bit) != 0 && member >= first && member < end) wanted |= 1 << (4 * k + j);
        }
    }
    return wanted;
}

// index of the lowest set bit
int lowest_bit(int bits) {
    return int(log2(float(bits & -bits)) + 0.5);
}
