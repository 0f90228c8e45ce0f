// Refracted ray of each grid point, and the flux into the two triangles of the cell that starts there.
// Held to caustics/flux/refracted_rays.py.
#include "caustics/flux/refracted_rays.glsl"
uniform sampler2D position;
uniform sampler2D normal;
uniform sampler2D lit;
uniform vec3 sun_in_air;
uniform float refractive_index;
uniform float flat_flux;  // of a cell of the flat sea, in tiles^2
uniform int grid;

layout(location = 0) out vec4 ray;   // origin less the grid point, in tiles; slope
layout(location = 1) out vec2 flux;  // relative to that of a flat cell: 1/2 each on a flat sea

// normal and transmittance; seen: whether the sun sees the point
vec4 corner(ivec2 step, out vec3 place, out float seen) {
    ivec2 at = ivec2(gl_FragCoord.xy) + step;
    at = ivec2(at.x < grid ? at.x : 0, at.y < grid ? at.y : 0);
    place = texelFetch(position, at, 0).xyz + vec3(step.x, 0.0, step.y) / float(grid);
    seen = texelFetch(lit, at, 0).r;
    vec3 n = texelFetch(normal, at, 0).xyz;
    return vec4(n, ray_transmittance(n, sun_in_air, refractive_index));
}

void main() {
    vec3 a, b, c, d;
    float la, lb, lc, ld;
    vec4 na = corner(ivec2(0, 0), a, la);
    float tb = corner(ivec2(1, 0), b, lb).w;
    float tc = corner(ivec2(1, 1), c, lc).w;
    float td = corner(ivec2(0, 1), d, ld).w;
    vec2 slope = ray_slope(na.xyz, sun_in_air, refractive_index);
    ray = vec4(a.xz + slope * a.y, slope);
    // the grid's x and z axes span a downward normal: corners in reverse order face up
    flux = vec2(facet_flux(a, c, b, (na.w + tb + tc) / 3.0, sun_in_air),
                facet_flux(a, d, c, (na.w + tc + td) / 3.0, sun_in_air)) / flat_flux;
    flux *= vec2(la + lb + lc, la + lc + ld) / 3.0;
}
