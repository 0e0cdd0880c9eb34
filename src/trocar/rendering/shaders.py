"""The programs of the graphics card: projection, light, shadows, lens and sensor.

Frames of eyes are optical: x right, y down, z ahead. Rows of a picture begin at the top, so the
card's y points down, too.
"""

from __future__ import annotations

from collections.abc import Iterable

VERSION = "#version 430\n"

_OBJECT = """
in vec3 point;
in vec4 row0;
in vec4 row1;
in vec4 row2;
uniform mat4 shadow;  // from the reference frame to the light's clip space

vec3 in_reference() {
    vec4 p = vec4(point, 1.0);
    return vec3(dot(row0, p), dot(row1, p), dot(row2, p));
}

vec3 turned_by(vec3 v) {
    return vec3(dot(row0.xyz, v), dot(row1.xyz, v), dot(row2.xyz, v));
}
"""

SHADOW_VERTEX = (
    _OBJECT
    + """
void main() {
    gl_Position = shadow * vec4(in_reference(), 1.0);
}
"""
)

SHADOW_FRAGMENT = """
void main() {}
"""

#: Clip space: see `optics.Pinhole`; its w is the depth. Tissue close behind others gets less light:
#: of each two opposite places of the shadow map, what is nearer than a vertex by up to a few radii
#: counts; a plane, however it is tilted, has none.
VERTEX = (
    _OBJECT
    + """
in vec3 normal;
in vec3 place;
in vec4 colour;
in vec4 finish;
uniform mat4 eye;  // from the reference frame
uniform vec4 pinhole;
uniform vec2 depths;
uniform vec3 light;
uniform vec4 power;   // of the light with the exposure, _, vignette, exposure
out vec3 at;
out vec3 across;
out vec3 toward;
out vec4 in_light;
flat out vec4 albedo;
flat out vec4 sheen;
flat out int id;
#ifdef TISSUE
uniform mat2x3 places;  // from points at rest to the texture
uniform float bump;
out vec2 spot;
flat out vec3 along_u;
flat out vec3 along_v;
out float open;
layout(binding = 10) uniform sampler2D hollow;
uniform vec3 reach;   // radius of contacts at depth 1 in the map, across and down; near over it
#endif
#ifdef GAUZE
out vec2 spot;
flat out vec3 along_u;
flat out vec3 along_v;
#endif

void main() {
    vec3 r = in_reference();
    vec3 turned = turned_by(normal);
    at = (eye * vec4(r, 1.0)).xyz;
    across = mat3(eye) * turned;
    albedo = colour;
    sheen = finish;
    id = int(finish.w);
#ifdef TISSUE
    spot = place * places;
    along_u = bump * mat3(eye) * turned_by(places[0]);
    along_v = bump * mat3(eye) * turned_by(places[1]);
#endif
#ifdef GAUZE
    spot = WEAVE * place.xy;
    along_u = mat3(eye) * turned_by(vec3(1.0, 0.0, 0.0));
    along_v = mat3(eye) * turned_by(vec3(0.0, 1.0, 0.0));
#endif
#ifdef SCOPE
    float unit = inversesqrt(power.x);
    toward = unit * (light - at);
    albedo.w = 0.5 * unit * light.x;
    sheen.w = 0.5 * unit * light.y;
#endif
#ifdef SHADOWS
    vec4 c = shadow * vec4(r, 1.0);
    in_light = vec4(0.5 * c.xyz + 0.5 * c.w, c.w);
#endif
#ifdef TISSUE
    open = 1.0;
#ifdef SHADOWS
    vec3 there = in_light.xyz / c.w;
    vec4 side = vec4(0.8, 0.6, -0.6, 0.8) * reach.xyxy / c.w;
    vec4 around = vec4(
        textureLod(hollow, there.xy + side.xy, 0.0).r,
        textureLod(hollow, there.xy - side.xy, 0.0).r,
        textureLod(hollow, there.xy + side.zw, 0.0).r,
        textureLod(hollow, there.xy - side.zw, 0.0).r
    );
    vec4 above = reach.z / (1.0 - there.z) - reach.z / (1.0 - around);
    above = clamp(above, -1.0, 1.0) * clamp(2.5 - 0.5 * above, 0.0, 1.0);
    open = 1.0 - 0.35 * dot(clamp(above.xz + above.yw, 0.0, 1.0), vec2(1.0));
#endif
#endif
    gl_Position = vec4(
        pinhole.x * at.x + pinhole.z * at.z,
        pinhole.y * at.y + pinhole.w * at.z,
        depths.x * at.z + depths.y,
        at.z
    );
}
"""
)

_OUTPUTS = """
#ifdef COLOUR
layout(location = COLOUR) out vec4 colour_out;
#endif
#ifdef DEPTH
layout(location = DEPTH) out float depth_out;
#endif
#ifdef IDS
layout(location = IDS) out int id_out;
#endif
#ifdef NORMALS
layout(location = NORMALS) out vec4 normal_out;
#endif
"""

#: A scope's light stands beside the eyes: one root serves its distance, the normal's length and,
#: with a step of Newton's, the way halfway between light and eye. Lengths are in units in which the
#: light's power is one. What a screen shows is about the root of the light, so colours are roots,
#: and only the amount of light goes through the curve.
_SCOPE = """
    float d2 = dot(toward, toward);
    float n2 = dot(facet, facet);
    float root = inversesqrt(d2 * n2);
    float per_d2 = n2 * root * root;
    float facing = max(dot(facet, toward) * root, 0.0);
    float lit = 1.0;
#ifdef SHADOWS
#ifdef PARALLEL
    vec3 there = vec3(in_light.xy * gl_FragCoord.w, gl_FragCoord.z);
#else
    vec3 there = in_light.xyz / in_light.w;
#endif
#ifdef SURGICAL
    lit = 0.5 * (textureLod(shade, there + vec3(-0.45, -0.8, 0.0) * blur, 0.0)
        + textureLod(shade, there + vec3(0.45, 0.8, 0.0) * blur, 0.0));
#else
    lit = textureLod(shade, there, 0.0);
#endif
#endif
    facing *= 1.0 - sheen.z + sheen.z * facing * facing;
    float ahead = toward.z * per_d2;
    float beam = ahead * ahead;
#ifdef VIGNETTE
    ahead *= toward.z;
    beam *= mix(1.0, ahead * ahead * ahead, power.z);
#endif
    float amount = (facing * lit + AROUND) * beam;
    vec3 h = toward - vec3(albedo.w, sheen.w, 0.0);
    float near = dot(facet, h) * root * (1.5 - 0.5 * dot(h, h) * per_d2);
"""

_ROOM = """
    vec3 t = light - at;
    float per_distance = inversesqrt(dot(t, t));
    float per_normal = inversesqrt(dot(facet, facet));
    float facing = max(dot(facet, t) * per_distance * per_normal, 0.0);
    float lit = 1.0;
#ifdef SHADOWS
    lit = textureProjLod(shade, in_light, 0.0);
#endif
    facing *= 1.0 - sheen.z + sheen.z * facing * facing;
    float beam = power.x * per_distance * per_distance;
    float from_above = 0.65 + 0.35 * dot(facet, sky.xyz) * per_normal;
    float amount = facing * lit * beam + sky.w * power.w * from_above;
    vec3 h = t * per_distance - normalize(at);
    float near = dot(facet, h) * per_normal * inversesqrt(dot(h, h));
#ifdef VIGNETTE
    float ahead = at.z * at.z / dot(at, at);
    amount *= mix(1.0, ahead * ahead * ahead, power.z);
#endif
"""

#: Light that tissue scatters below its surface is red, and seen best where little falls on it.
#: Source: chosen by eye. Colours are dithered by interleaved gradient noise, so that smooth cloth
#: shows no bands; source: Jimenez, "Next generation post processing in Call of Duty", 2014.
_SURGICAL = """
#ifdef SURGICAL
    vec3 base = albedo.rgb;
#ifdef GAUZE
    base *= 0.92 + 0.08 * raised;
#endif
#ifdef TISSUE
    base *= vec3(0.66, 0.36, 0.38) + vec3(0.62, 1.12, 1.06) * skin.z;
    base.r = mix(base.r, sqrt(base.r), 0.5 * (1.0 - facing * lit));
#ifdef BLEEDING
    vec3 blood = mix(vec3(0.52, 0.07, 0.06), vec3(0.40, 0.03, 0.03), smoothstep(0.9, 0.3, deep));
    base = mix(base, blood, 0.92 * bloody);
    float sharp = lobe * lobe * lobe;
    lobe = mix(lobe, sharp * sharp, bloody);
#endif
    amount = amount * open + 0.07 * beam;
#endif
#endif
"""

FRAGMENT = (
    _OUTPUTS
    + """
in vec3 at;
in vec3 across;
in vec3 toward;       // a scope's light, in units in which its power is one
in vec4 in_light;
flat in vec4 albedo;  // roots of red, green, blue; a scope's light from the eye, halved: x
flat in vec4 sheen;   // sharpness of glints, their strength, how metallic; the same, y
flat in int id;
uniform vec3 light;
uniform vec4 power;
uniform vec4 sky;     // up in the eye's frame, strength of the light from all around
uniform sampler2DShadow shade;
#ifdef BLEEDING
uniform vec4 pool;    // the point that bleeds, and how far blood has spread from there
uniform vec3 rise;    // upwards
#endif
#ifdef SURGICAL
uniform float blur;
layout(binding = 8) uniform sampler2D structure;
layout(binding = 9) uniform sampler2D mirror;
#endif
#ifdef TISSUE
in vec2 spot;
in float open;
flat in vec3 along_u;
flat in vec3 along_v;
#endif
#ifdef GAUZE
in vec2 spot;
flat in vec3 along_u;
flat in vec3 along_v;
#endif

void main() {
#ifdef COLOUR
#ifdef GAUZE
    vec2 over = sin(spot), steep = cos(spot);
    float raised = over.x * over.y;
    vec3 facet = across - 0.45 * (steep.x * over.y * along_u + over.x * steep.y * along_v);
#elif defined(TISSUE)
    vec4 skin = texture(structure, spot);
    vec3 facet = across + (skin.x - 0.5) * along_u + (skin.y - 0.5) * along_v;
#ifdef BLEEDING
    vec3 off = at - pool.xyz;
    float above = dot(off, rise);
    float rim = pool.w * (0.55 + 0.9 * textureLod(structure, 0.4 * spot, 3.0).z) + 1e-9;
    float deep = length(off - above * rise) / rim;
    float bloody = smoothstep(1.0, 0.9, deep) * smoothstep(2.0e-3, 1.4e-3, above);
    facet = mix(facet, across, 0.85 * bloody);
#endif
#else
    vec3 facet = across;
#endif
#ifdef SCOPE
"""
    + _SCOPE
    + "#else\n"
    + _ROOM
    + """
#endif
    float lobe = max(1.0 - sheen.x * (1.0 - near), 0.0);
    lobe *= lobe;
"""
    + _SURGICAL
    + """
    float shown = amount / (1.0 + amount);
    float glint = sheen.y * lobe * lobe * lit * shown;
#ifdef SURGICAL
    vec3 c = min(base * sqrt(shown), 1.0);
    float bright = sqrt(beam / (1.0 + beam));
#ifdef METAL
    vec3 r = reflect(at * inversesqrt(dot(at, at)), facet * inversesqrt(n2));
    float sphere = 0.5 * inversesqrt(2.0 * (1.001 - r.z));
    c = 0.55 * c + 0.72 * bright * textureLod(mirror, r.xy * sphere + 0.5, 0.0).rgb;
#endif
#ifdef TISSUE
#ifdef BLEEDING
    skin.w = mix(skin.w, 0.5, bloody);
#endif
    glint *= 0.2 + 3.2 * skin.w;
#endif
#ifdef GAUZE
    glint *= 0.1;
#endif
    c += min(glint, 1.0) * (1.0 - c);
#ifdef SMOKE
    c = mix(c, vec3(0.66, 0.64, 0.63) * bright, 1.0 - exp2(-power.y * at.z));
#endif
    c += (fract(52.9829189 * fract(dot(gl_FragCoord.xy, vec2(0.06711056, 0.00583715)))) - 0.5)
        / 255.0;
#else
    vec3 c = albedo.rgb * sqrt(shown) + vec3(glint);
#endif
    colour_out = vec4(c, 1.0);
#endif
#ifdef DEPTH
    depth_out = 1.0 / gl_FragCoord.w;
#endif
#ifdef IDS
    id_out = id;
#endif
#ifdef NORMALS
    normal_out = vec4(normalize(across), 0.0);
#endif
}
"""
)


def source(text: str, defines: Iterable[str] = ()) -> str:
    """Return a shader with its version and what is switched on in it, such as "DEPTH 1"."""
    return VERSION + "".join(f"#define {name}\n" for name in defines) + text


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
