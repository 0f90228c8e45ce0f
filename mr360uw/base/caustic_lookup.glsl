// twin: caustic_lookup.py
// `ratio` holds the mip_atlas of a stack and filters linearly, `plane_depth` its plane_steps
struct CausticStack {
    float tile_m;
    vec3 sun_direction;
};

#include "composite/gl/shaders/atlas_level.glsl"

vec3 caustic_lookup(CausticStack stack, sampler2DArray ratio, sampler2D plane_depth, vec3 point, float footprint_m) {
    CausticPlace place = caustic_place(stack, ratio, plane_depth, point, footprint_m);
    return caustic_colours(ratio, place);
}

// of a stack with `soft` as its last layers: the pattern of a beam of which a share has not turned
vec3 soft_caustic_lookup(CausticStack stack, sampler2DArray ratio, sampler2D plane_depth, vec3 point,
                         float footprint_m, vec3 unturned) {
    CausticPlace place = caustic_place(stack, ratio, plane_depth, point, footprint_m);
    float soft = caustic_layer(ratio, place, float(colours_of(ratio, place) * place.layers) + place.layer);
    return mix(vec3(soft), caustic_colours(ratio, place), unturned);
}
