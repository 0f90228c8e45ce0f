// twin: coverage.py
float edge_coverage(vec2 a, vec2 b) {
    float y0 = clamp(a.y, 0.0, 1.0);
    float y1 = clamp(b.y, 0.0, 1.0);
    float rise = b.y - a.y;
    float inverse = (b.x - a.x) / (rise == 0.0 ? 1.0 : rise);
    float x0 = a.x + inverse * (y0 - a.y);
    float x1 = a.x + inverse * (y1 - a.y);
    float c0 = clamp(x0, 0.0, 1.0);
    float c1 = clamp(x1, 0.0, 1.0);
    float run = x1 - x0;
    float mean = abs(run) < 1e-6 ? 0.5 * (c0 + c1) : (0.5 * (c1 - c0) * (c0 + c1) + max(x1, 1.0) - max(x0, 1.0)) / run;
    return (y1 - y0) * mean;
}

float twice_area(vec2 a, vec2 b, vec2 c) {
    return (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
}
