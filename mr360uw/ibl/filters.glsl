// twin: filters.py
vec2 split_sum(float r, float v) {
    float white = (1.004 + v * (0.1061 - v * (0.1398 + 0.1248 * v))
                   + r * (-2.549 + v * (0.1271 + 0.4051 * v) + r * (2.37 - 0.5209 * v - 0.5446 * r)));
    white = white / (1.0 + v * (0.05538 - 0.209 * v) + r * (-2.2 + 0.2572 * v + 1.505 * r));
    float b = 0.9969 + v * (-1.096 + 1.0529 * v) + r * (-1.0901 + 0.0253 * v + 0.484 * r);
    b = b / (1.0 + v * (0.0215 + 7.8124 * v) + r * (-0.292 - 13.4496 * v + 8.9049 * r));
    float x = 1.0 - v;
    b = max(x * x * x * b, 0.0);
    return vec2(min(white, 1.0) - b, b);
}
