"""What lens and sensor make of a picture: distortion and noise."""

from __future__ import annotations

LENS_VERTEX = """
void main() {
    gl_Position = vec4(2.0 * (gl_VertexID & 2) - 1.0, 4.0 * (gl_VertexID & 1) - 1.0, 0.0, 1.0);
}
"""

#: Between four pixels of one surface, 1 / depth is linear on the screen, so a plane stays a plane.
#: Noise is the sum of four even ones, nearly Gaussian; the hash is O'Neill's PCG.
LENS_FRAGMENT = """
#ifdef COLOUR
layout(location = COLOUR) out vec4 colour_out;
uniform sampler2D colour_in;
#endif
#ifdef DEPTH
layout(location = DEPTH) out float depth_out;
uniform sampler2D depth_in;
#endif
#ifdef IDS
layout(location = IDS) out int id_out;
uniform isampler2D ids_in;
#endif
#ifdef NORMALS
layout(location = NORMALS) out vec4 normal_out;
uniform sampler2D normals_in;
#endif
uniform sampler2D places;
uniform vec2 size;
uniform float noise;
uniform uint seed;

uint mixed(uint v) {
    uint state = v * 747796405u + 2891336453u;
    uint word = ((state >> ((state >> 28) + 4u)) ^ state) * 277803737u;
    return (word >> 22) ^ word;
}

float grain(inout uint state) {
    float sum = -2.0;
    for (int k = 0; k < 4; ++k) {
        state = mixed(state);
        sum += float(state >> 8) / 16777216.0;
    }
    return 1.7320508 * sum;
}

#ifdef DEPTH
float deep(vec2 place) {
    ivec2 corner = ivec2(floor(place));
    vec2 share = place - vec2(corner);
    vec4 near = 1.0 / vec4(
        texelFetch(depth_in, corner, 0).r,
        texelFetch(depth_in, corner + ivec2(1, 0), 0).r,
        texelFetch(depth_in, corner + ivec2(0, 1), 0).r,
        texelFetch(depth_in, corner + ivec2(1, 1), 0).r
    );
    float least = min(min(near.x, near.y), min(near.z, near.w));
    float most = max(max(near.x, near.y), max(near.z, near.w));
    if (least < 0.97 * most)
        return texelFetch(depth_in, ivec2(floor(place + 0.5)), 0).r;
    return 1.0 / mix(mix(near.x, near.y, share.x), mix(near.z, near.w, share.x), share.y);
}
#endif

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
#ifdef PLACES
    vec2 place = texelFetch(places, pixel, 0).xy;
#else
    vec2 place = vec2(pixel);
#endif
    ivec2 nearest = ivec2(floor(place + 0.5));
#ifdef COLOUR
    vec3 c = textureLod(colour_in, (place + 0.5) / size, 0.0).rgb;
#ifdef NOISE
    uint state = mixed(uint(pixel.x) + 65536u * uint(pixel.y)) ^ seed;
    c.r += noise * grain(state);
    c.g += noise * grain(state);
    c.b += noise * grain(state);
#endif
    colour_out = vec4(c, 1.0);
#endif
#ifdef DEPTH
    depth_out = deep(place);
#endif
#ifdef IDS
    id_out = texelFetch(ids_in, nearest, 0).r;
#endif
#ifdef NORMALS
    normal_out = texelFetch(normals_in, nearest, 0);
#endif
}
"""
