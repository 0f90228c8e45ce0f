// Albedo and light of the floor. Held to surface/sea_floor.py
struct Tiled {
    float tile_m;
    vec2 origin;
};

vec3 tiled_at(Tiled tiled, sampler2D picture, vec2 place, float footprint_m) {
    float pixel = tiled.tile_m / float(textureSize(picture, 0).x);
    vec2 tiles = (place - tiled.origin) / tiled.tile_m;
    return textureLod(picture, tiles - floor(tiles), log2(max(footprint_m / (sqrt(3.0) * pixel), 1.0))).rgb;
}
