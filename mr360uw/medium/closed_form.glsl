// twin: closed_form.py
float ray_in_water(float distance, float depth, float up) {
    return min(max(distance, 0.0), up > 0.0 ? min(max(depth, 0.0) / up, LONGEST_RAY_M) : LONGEST_RAY_M);
}

// no expm1 here: a series where the quotient would cancel
float mean_transmittance(float x) {
    if (x > 0.5) return (1.0 - exp(-x)) / x;
    return 1.0 - x / 2.0 * (1.0 - x / 3.0 * (1.0 - x / 4.0 * (1.0 - x / 5.0 * (1.0 - x / 6.0 * (1.0 - x / 7.0)))));
}

float path_integral(float c, float k, float s, float y, float mu) {
    float q = (c - k * mu) * s;
    return s * exp(-k * y - min(q, 0.0)) * mean_transmittance(abs(q));
}

float closed_form(float b, float c, float k, float s, float y, float mu) {
    return b * INV_4PI * path_integral(c, k, ray_in_water(s, y, mu), max(y, 0.0), mu);
}
