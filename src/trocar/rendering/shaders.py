"""What the graphics card computes: where a point lands, and what light comes from there.

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

#: Clip space: see `lenses.Pinhole`; its w is the depth.
VERTEX = (
    _OBJECT
    + """
in vec3 normal;
in vec4 colour;
in vec4 finish;
uniform mat4 eye;  // from the reference frame
uniform vec4 pinhole;
uniform vec2 depths;
out vec3 at;
out vec3 across;
out vec4 in_light;
flat out vec4 albedo;
flat out vec4 sheen;

void main() {
    vec3 r = in_reference();
    vec3 turned = vec3(dot(row0.xyz, normal), dot(row1.xyz, normal), dot(row2.xyz, normal));
    at = (eye * vec4(r, 1.0)).xyz;
    across = mat3(eye) * turned;
    albedo = colour;
    sheen = finish;
#ifdef SHADOWS
    vec4 c = shadow * vec4(r, 1.0);
    in_light = vec4(0.5 * c.xyz + 0.5 * c.w, c.w);
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

#: A lobe 1 / (1 + a (1 - cos))^2 instead of a power of the cosine: as round, and a third of the
#: time. Light falls off with the square of the distance; screens' colours are about its root.
FRAGMENT = (
    _OUTPUTS
    + """
in vec3 at;
in vec3 across;
in vec4 in_light;
flat in vec4 albedo;  // red, green, blue, how metallic
flat in vec4 sheen;   // sharpness of the lobe, its strength, share of diffuse light, id
uniform vec3 light;
uniform vec4 power;   // of the light, its softening [m^2], vignette, exposure
uniform vec4 sky;     // up in the eye's frame, strength of the light from all around
uniform sampler2DShadow shade;

void main() {
#ifdef COLOUR
    vec3 t = light - at;
    float d2 = dot(t, t);
    float per_distance = inversesqrt(d2);
    float per_normal = inversesqrt(dot(across, across));
    float facing = max(dot(across, t) * per_distance * per_normal, 0.0);
    float fall = power.x / (d2 + power.y);
    float ahead = at.z * inversesqrt(dot(at, at));
#ifdef SCOPE
    vec3 h = 0.5 * light - at;
    fall *= ahead * ahead;
    float around = sky.w * fall;
#else
    vec3 h = t * per_distance - normalize(at);
    float around = sky.w * (0.65 + 0.35 * dot(across, sky.xyz) * per_normal);
#endif
    float near = max(dot(across, h) * per_normal * inversesqrt(dot(h, h)), 0.0);
#ifdef SHADOWS
    fall *= textureProjLod(shade, in_light, 0.0);
#endif
    float lobe = 1.0 / (1.0 + sheen.x * (1.0 - near));
    float glint = sheen.y * lobe * lobe;
    vec3 c = albedo.rgb * (sheen.z * (facing * fall + around));
    c += mix(vec3(glint), glint * albedo.rgb, albedo.a) * fall;
#ifdef VIGNETTE
    float dim = ahead * ahead;
    c *= mix(1.0, dim * dim, power.z);
#endif
    c *= power.w;
    colour_out = vec4(sqrt(c * (1.0 + 0.1 * c) / (1.0 + c)), 1.0);
#endif
#ifdef DEPTH
    depth_out = 1.0 / gl_FragCoord.w;
#endif
#ifdef IDS
    id_out = int(sheen.w);
#endif
#ifdef NORMALS
    normal_out = vec4(normalize(across), 0.0);
#endif
}
"""
)

#: Behind everything: one triangle over the whole picture.
BEHIND_VERTEX = """
void main() {
    gl_Position = vec4(2.0 * (gl_VertexID & 2) - 1.0, 4.0 * (gl_VertexID & 1) - 1.0, 1.0, 1.0);
}
"""

BEHIND_FRAGMENT = (
    _OUTPUTS
    + """
uniform vec3 backdrop;
void main() {
#ifdef COLOUR
    colour_out = vec4(backdrop, 1.0);
#endif
#ifdef DEPTH
    depth_out = uintBitsToFloat(0x7f800000u);
#endif
#ifdef IDS
    id_out = 0;
#endif
#ifdef NORMALS
    normal_out = vec4(0.0);
#endif
}
"""
)


def source(text: str, defines: Iterable[str] = ()) -> str:
    """Return a shader with its version and what is switched on in it, such as "DEPTH 1"."""
    return VERSION + "".join(f"#define {name}\n" for name in defines) + text
