// Surface at the intersection of a ray and a triangle: point, normals, material. Held to composite/raycast.py
// and base/rays.py.
// A triangle is eleven texels of `triangles`: for each corner (position, u), (normal, v), colour; then (material, patch,
// two halves of the address of its further sets of texture coordinates);
// then its points of ambient light (ambient/mesh_transfer.py). Those sets follow all triangles.
// A material is nine texels of `materials`, which device.py writes.
// Maps are switched at compile time, because software drivers execute both sides of every branch.
#include "composite/gl/shaders/texture.glsl"

const int TRIANGLE_TEXELS = 11;
const int MATERIAL_TEXELS = 9;

struct Triangle {
    vec3 a, b, c;
    int first;
    int material;
    float patch_number;
};

struct Surface {
    vec3 point;
    float distance_m;
    vec3 direction;
    vec3 geometric_normal;
    vec3 normal;
    vec4 base;
    float metallic;
    float roughness;
    vec3 emission;
    float occlusion;
    float refractive_index;
    vec3 trim;
    float footprint_m;
    vec3 weights;
    bool behind;
    vec3 normal_change[2];  // over a pixel, along columns and rows; of glossy meshes
};

// A facet is three vectors of a triangle: a ray d meets it if d.a, d.b, d.c are not negative. Their sum is one over the
// distance, and divided by it they are the barycentric weights of the corners.
struct Facet {
    vec3 a;
    vec3 b;
    vec3 c;
};

Facet make_facet(vec3 a, vec3 b, vec3 c) {
    vec3 bc = cross(b, c - b);
    float volume = dot(a, bc);
    return Facet(bc / volume, cross(c, a - c) / volume, cross(a, b - a) / volume);
}

// (weights of the corners, distance)
vec4 barycentric(Facet facet, vec3 direction) {
    vec3 weights = vec3(dot(direction, facet.a), dot(direction, facet.b), dot(direction, facet.c));
    float total = weights.x + weights.y + weights.z;
    if (abs(total) < 1e-30) total = 1e-30;
    return vec4(weights, 1.0) / total;
}

const float LARGEST_CHANGE = 0.5;

// number of an item: targets hold them in blocks of 4 x 4 texels, because software drivers draw such blocks at once
const int LANE_COLUMNS = 256;  // twin: device.py

int lane_number(ivec2 at) {
    return (((at.y >> 2) * (LANE_COLUMNS >> 2) + (at.x >> 2)) << 4) + ((at.y & 3) << 2) + (at.x & 3);
}

// texel of an entry of a list in rows of 2048: shifts, because software drivers divide integers one lane at a time
ivec2 list_place(int index) {
    return ivec2(index & 2047, index >> 11);
}

vec4 listed(sampler2D list, int index) {
    return texelFetch(list, list_place(index), 0);
}

// a triangle with its corners from the camera in the world's axes; `placed` transforms the object's axes to those
Triangle fetch_triangle(sampler2D triangles, mat4 placed, int number) {
    int first = number * TRIANGLE_TEXELS;
    vec4 last = listed(triangles, first + 9);
    return Triangle((placed * vec4(listed(triangles, first).xyz, 1.0)).xyz,
                    (placed * vec4(listed(triangles, first + 3).xyz, 1.0)).xyz,
                    (placed * vec4(listed(triangles, first + 6).xyz, 1.0)).xyz, first, int(last.x), last.y);
}

mat3x2 fetch_uv(sampler2D triangles, int first) {
    return mat3x2(listed(triangles, first).w, listed(triangles, first + 1).w,
                  listed(triangles, first + 3).w, listed(triangles, first + 4).w,
                  listed(triangles, first + 6).w, listed(triangles, first + 7).w);
}

// where a pixel lies on a map: texture coordinates of the triangle's corners and of the pixel, and the changes of the
// latter over half a pixel
struct MapPlace {
    mat3x2 corners;
    vec2 uv, du, dv;
};

vec2 uv_change(Facet facet, mat3x2 uv, vec2 here, vec3 neighbour) {
    return clamp(uv * barycentric(facet, neighbour).xyz - here, -1e3, 1e3);
}

// normals: of the corners. neighbour: ray half a pixel away
vec3 normal_change(Facet facet, mat3 normals, vec3 normal, vec3 neighbour) {
    vec3 beside = normals * barycentric(facet, neighbour).xyz;
    vec3 change = 2.0 * (beside / max(length(beside), 1e-12) - normal);
    return change * min(1.0, LARGEST_CHANGE / max(length(change), 1e-12));
}

MapPlace map_place(Facet facet, mat3x2 corners, vec3 weights, vec3 next_column, vec3 next_row) {
    vec2 uv = corners * weights;
    return MapPlace(corners, uv, uv_change(facet, corners, uv, next_column), uv_change(facet, corners, uv, next_row));
}

#if defined(MORE_UV)
const int SETS = 8, ADDRESS_BITS = 12;  // twin: device.py

// place on the map `slot` of a material, the first of which are metallic and roughness; digits: those of its sets
MapPlace place_of(sampler2D triangles, int first, float digits, int slot, MapPlace base, Facet facet, vec3 weights,
                  vec3 next_column, vec3 next_row) {
    int set = (int(digits) >> (3 * slot)) & (SETS - 1);
    if (set == 0) return base;
    vec2 address = listed(triangles, first + 9).zw;
    int at = (int(address.x) << ADDRESS_BITS) + int(address.y) + 3 * (set - 1);
    mat3x2 corners = mat3x2(listed(triangles, at).xy, listed(triangles, at + 1).xy, listed(triangles, at + 2).xy);
    return map_place(facet, corners, weights, next_column, next_row);
}
#else
#define place_of(triangles, first, digits, slot, base, facet, weights, next_column, next_row) (base)
#endif

vec4 base_color(sampler2D triangles, sampler2D materials, sampler2D store, Triangle triangle, vec3 weights,
                vec2 uv, vec2 du, vec2 dv) {
    vec4 color = weights.x * listed(triangles, triangle.first + 2) + weights.y * listed(triangles, triangle.first + 5)
               + weights.z * listed(triangles, triangle.first + 8);
    int row = triangle.material * MATERIAL_TEXELS;
    color *= listed(materials, row);
#if defined(BASE_MAP)
    vec4 map = listed(materials, row + 3);
    if (map.x >= 0.0) color *= texture_lookup(store, map, uv, du, dv);
#endif
    return color;
}

vec3 bumped(vec3 normal, vec3 e1, vec3 e2, mat3x2 uv, vec3 bump) {
    vec2 d1 = uv[1] - uv[0], d2 = uv[2] - uv[0];
    float side = sign(d1.x * d2.y - d2.x * d1.y);
    vec3 tangent = side * (e1 * d2.y - e2 * d1.y), up = -side * (e2 * d1.x - e1 * d2.x);
    tangent -= normal * dot(normal, tangent);
    up -= normal * dot(normal, up);
    tangent /= max(length(tangent), 1e-18);
    up /= max(length(up), 1e-18);
    vec3 turned = bump.x * tangent + bump.y * up + bump.z * normal;
    float size = length(turned);
    return size > 1e-6 ? turned / size : normal;
}

Surface surface(sampler2D triangles, sampler2D materials, sampler2D store, mat4 placed, Triangle triangle,
                vec3 direction, vec3 next_column, vec3 next_row, float pixel_rad) {
    Facet facet = make_facet(triangle.a, triangle.b, triangle.c);
    vec4 hit = barycentric(facet, direction);
    MapPlace base = map_place(facet, fetch_uv(triangles, triangle.first), hit.xyz, next_column, next_row), at;
    Surface s;
    s.base = base_color(triangles, materials, store, triangle, hit.xyz, base.uv, base.du, base.dv);
    s.distance_m = hit.w;
    s.direction = direction;
    s.point = hit.w * direction;
    s.footprint_m = hit.w * pixel_rad;
    vec3 e1 = triangle.b - triangle.a, e2 = triangle.c - triangle.a;
    vec3 flat_normal = normalize(cross(e1, e2));
    float side = -sign(dot(flat_normal, direction));
    s.geometric_normal = flat_normal * side;
    mat3 normals = mat3(placed) * mat3(listed(triangles, triangle.first + 1).xyz, listed(triangles, triangle.first + 4).xyz,
                                       listed(triangles, triangle.first + 7).xyz);
    vec3 normal = normalize(normals * hit.xyz);
#if defined(SMOOTH)
    s.normal_change[0] = side * normal_change(facet, normals, normal, next_column);
    s.normal_change[1] = side * normal_change(facet, normals, normal, next_row);
#endif
    int row = triangle.material * MATERIAL_TEXELS;
    vec4 factors = listed(materials, row + 1);
    s.metallic = factors.x;
    s.roughness = factors.y;
    vec4 glow = listed(materials, row + 2);
    s.emission = glow.rgb;
    vec4 trim = listed(materials, row + 8);
    s.trim = trim.rgb;
    s.refractive_index = trim.w;
    s.occlusion = 1.0;
    vec4 map;
#if defined(METALLIC_ROUGHNESS_MAP)
    map = listed(materials, row + 4);
    if (map.x >= 0.0) {
        at = place_of(triangles, triangle.first, glow.w, 0, base, facet, hit.xyz, next_column, next_row);
        vec4 texel = texture_lookup(store, map, at.uv, at.du, at.dv);
        s.metallic *= texel.b;
        s.roughness *= texel.g;
    }
#endif
#if defined(OCCLUSION_MAP)
    map = listed(materials, row + 6);
    if (map.x >= 0.0) {
        at = place_of(triangles, triangle.first, glow.w, 2, base, facet, hit.xyz, next_column, next_row);
        s.occlusion += factors.w * (texture_lookup(store, map, at.uv, at.du, at.dv).r - 1.0);
    }
#endif
#if defined(EMISSION_MAP)
    map = listed(materials, row + 7);
    if (map.x >= 0.0) {
        at = place_of(triangles, triangle.first, glow.w, 3, base, facet, hit.xyz, next_column, next_row);
        s.emission *= texture_lookup(store, map, at.uv, at.du, at.dv).rgb;
    }
#endif
#if defined(NORMAL_MAP)
    map = listed(materials, row + 5);
    if (map.x >= 0.0) {
        at = place_of(triangles, triangle.first, glow.w, 1, base, facet, hit.xyz, next_column, next_row);
        vec3 bump = 2.0 * texture_lookup(store, map, at.uv, at.du, at.dv).rgb - 1.0;
        bump.xy *= factors.z;
        normal = bumped(normal, e1, e2, at.corners, bump);
    }
#endif
    s.normal = normal * side;
    s.weights = hit.xyz;
    s.behind = side < 0.0;
    return s;
}
