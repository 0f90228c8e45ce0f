// twin: phase.py
float henyey_greenstein(float cos_theta, float g) {
    float d = (1.0 - g) * (1.0 - g) + 2.0 * g * (1.0 - cos_theta);
    return INV_4PI * (1.0 - g * g) / (d * sqrt(d));
}

float molecular(float cos_theta, float depolarisation) {
    float f = (1.0 - depolarisation) / (1.0 + depolarisation);
    return 3.0 * INV_4PI / (3.0 + f) * (1.0 + f * cos_theta * cos_theta);
}
