"""GLSL of whole people: skin, eyes, cloth, hair and brows, lit by lamps that cast shadows."""

from __future__ import annotations

from typing import Final

from twohands.synth.render.shaders import GRAIN, MAX_LIGHTS, NOISE, TONE

FABRICS: Final = 9
"""Fabrics that one person wears at most: `looks.ZONES`, then lanyard, glasses, hat and badge."""
HANDS: Final = 40
"""Capsules of two hands."""
SHADOWS: Final = 2
"""Lamps that cast shadows."""

SHADOW_VERTEX: Final = """
#version 330
uniform mat4 projection;
in vec3 position;

void main() {
    gl_Position = projection * vec4(position, 1.0);
}
"""

SHADOW_FRAGMENT: Final = """
#version 330
void main() {}
"""

_VERTEX: Final = f"""
uniform mat4 projection;
#ifdef HANDS
uniform vec4 capsule_from[{HANDS}];  // the hands' bones: one end, and the radius
uniform vec4 capsule_along[{HANDS}];  // to the other end, and 1 / length^2
uniform int capsule_count;
#endif
uniform float labelled;
in vec3 position, normal;
in vec2 uv;
in vec4 traits, more;
in vec3 rest;
in float part;
out vec3 point, facing, at_rest;
out vec2 place;
out vec4 look, also;
flat out float label;
flat out int zone;
out float depth;

void main() {{
    point = position;
    facing = normal;
    at_rest = rest;
    place = uv;
    look = traits;
    also = more;
    zone = int(more.w + 0.5);
    label = labelled > 0.5 ? part : 255.0;
    depth = position.z;
    gl_Position = projection * vec4(position, 1.0);
#ifdef HANDS
    float hidden = 0.0;  // fingers keep light from each other, and from what they touch
    for (int i = 0; i < capsule_count; ++i) {{
        vec3 u = capsule_along[i].xyz, w = position - capsule_from[i].xyz;
        float radius = capsule_from[i].w;
        vec3 d = clamp(dot(u, w) * capsule_along[i].w, 0.0, 1.0) * u - w;
        float near = inversesqrt(dot(d, d));
        hidden += max(dot(normal, d) * near, 0.0) * min(radius * radius * near * near, 1.0);
    }}
    also.y *= 1.0 / (1.0 + 1.3 * hidden);
#endif
}}
"""
PERSON_VERTEX: Final = "#version 330\n" + _VERTEX
SHADED_VERTEX: Final = "#version 330\n#define HANDS\n" + _VERTEX
"""Moves nothing; the second one finds how much light the hands leave."""

_CUT: Final = """
uniform float sleeve_from;
void cut_sleeve(float along) {
    if (along < sleeve_from) discard;
}
"""

_STRANDS: Final = """
uniform float hat_line;  // hair above this height at rest is under a hat
uniform sampler2D strands;  // brightness of the strand, its length, tilt, coarse brightness

// Leaves the gaps between strands of hair: look is place across, along, distance from the edge, card or cap.
vec4 strand(vec4 look) {
    vec4 fine = texture(strands, vec2(look.x * 9.0, look.y * 0.6));
    float end = look.w > 0.5 ? 1.25 * look.y - 0.35 : 0.0;
    float side = look.w > 0.5 ? 0.75 - 1.8 * look.z : 0.9 - 3.0 * look.z;
    if (max(end, side) > fine.y || at_rest.y < hat_line) discard;
    return fine;
}
"""

_LABEL: Final = """
#version 330
uniform vec2 shown;  // only labels from here to there
flat in float label;
in float depth;
in vec3 at_rest;
in vec4 look;
layout(location = 0) out float part;
layout(location = 1) out float z;

void write() {
    if (label < shown.x || label > shown.y) discard;
    part = label / 255.0;
    z = depth;
}
"""

LABEL_SKIN: Final = f"{_LABEL}void main() {{ write(); }}"
LABEL_CLOTH: Final = f"{_LABEL}{_CUT}void main() {{ cut_sleeve(look.x); write(); }}"
LABEL_HAIR: Final = f"{_LABEL}{_STRANDS}void main() {{ strand(look); write(); }}"

_HEAD: Final = f"""
#version 330
uniform vec3 light_position[{MAX_LIGHTS}];
uniform vec3 light_colour[{MAX_LIGHTS}];
uniform int light_count;
uniform vec3 sky, ground;
uniform mat4 shadow_from[{SHADOWS}];  // from the camera frame into a lamp's picture
uniform int shadow_of[{SHADOWS}];  // which lamp
uniform sampler2DShadow shadow_a, shadow_b;
uniform float metre;
uniform vec2 texel;  // size of a shadow's texels
uniform vec3 seed;
in vec3 point, facing, at_rest;
in vec2 place;
in vec4 look, also;
flat in int zone;
out vec4 colour;

{NOISE}
{GRAIN}
{TONE}

float passed(sampler2DShadow map, mat4 from, vec3 p) {{
    vec4 q = from * vec4(p, 1.0);
    vec3 c = q.xyz / q.w * 0.5 + 0.5;
    if (q.w < 0.0 || c.x < 0.01 || c.y < 0.01 || c.x > 0.99 || c.y > 0.99 || c.z > 1.0) return 1.0;
    return texture(map, c);
}}

// Share of every lamp that reaches a point with this normal.
vec4 reached(vec3 p, vec3 n) {{
    vec4 share = vec4(1.0);
    share[shadow_of[0]] = passed(shadow_a, shadow_from[0], p + (2.2 * texel[0] + 0.002 * metre) * n);
    share[shadow_of[1]] *= passed(shadow_b, shadow_from[1], p + (2.2 * texel[1] + 0.002 * metre) * n);
    return share;
}}

vec3 around(vec3 n, float open, vec3 bounce) {{
    return mix(ground, sky, 0.5 - 0.5 * n.y) * mix(pow(vec3(open), 1.0 - 0.6 * bounce), vec3(1.0), open);
}}

// Frame along the map: columns are where x and y of `at` grow, and the normal.
mat3 tangents(vec3 n, vec2 at) {{
    vec3 px = dFdx(point), py = dFdy(point);
    vec2 ux = dFdx(at), uy = dFdy(at);
    vec3 a = cross(py, n), b = cross(n, px);
    vec3 t = a * ux.x + b * uy.x, u = a * ux.y + b * uy.y;
    float longest = inversesqrt(max(max(dot(t, t), dot(u, u)), 1e-20));
    return mat3(t * longest, u * longest, n);
}}
"""

SKIN_FRAGMENT: Final = f"""{_HEAD}
uniform sampler2D skin_map;
uniform vec3 mean, skin_albedo, palm_albedo, hair_albedo, lips;
uniform vec3 detail;  // how much of the map shows in red, green, blue
uniform float roughness, stubble, moustache, scalp, white, flushed;

void main() {{
    vec3 v = normalize(-point), n = normalize(facing);
    float towards = dot(n, v);
    if (towards < 0.0) n = normalize(n - 1.05 * towards * v);
    vec3 shown = texture(skin_map, place).rgb;
    shown *= shown;
    vec3 ratio = clamp(shown / mean, 0.02, 3.0);
    float red = smoothstep(1.05, 1.5, ratio.r / max(ratio.g, 0.02));
    vec3 base = mix(skin_albedo, palm_albedo, look.x) * pow(ratio, detail);
    base *= mix(vec3(1.0), lips, red * step(0.5, also.x));
    float blotch = noise(at_rest * 38.0 + seed) - 0.5, grain = grains((at_rest + seed) * 700.0 + blotch * 8.0);
    base *= 1.0 + vec3(0.10, 0.16, 0.16) * blotch + 0.10 * grain;
    base *= mix(vec3(1.0), vec3(1.08, 0.82, 0.80), clamp(look.y * (0.55 + 0.8 * blotch) * flushed, 0.0, 1.0));
    // Hair that is too short for a mesh: on the scalp, on chin, cheeks and lip.
    float coarse = noise(at_rest * 160.0 + seed);
    float short_hair = look.z * scalp * (0.80 + 0.2 * coarse);
    float shaven = max(look.w * stubble, also.z * moustache);
    float grown = smoothstep(0.25, 0.75, shaven * (0.75 + 0.5 * coarse)) * (0.35 + 0.6 * min(shaven, 1.0));
    short_hair = max(short_hair, grown);
    vec3 hairs = mix(hair_albedo, vec3(0.35), white * coarse) * (0.7 + 0.6 * grain);
    base = mix(base, hairs, short_hair);
    float gloss = mix(roughness * (1.0 + 0.25 * grain), 0.75, short_hair);

    vec4 share = reached(point, n);
    vec3 lit = base * around(n, also.y, base);
    vec3 wrap = vec3(0.28, 0.14, 0.09);
    for (int i = 0; i < light_count; ++i) {{
        vec3 to_light = light_position[i] - point;
        float d2 = dot(to_light, to_light);
        vec3 l = to_light * inversesqrt(d2);
        vec3 diffuse = max((dot(n, l) + wrap) / ((1.0 + wrap) * (1.0 + wrap)), 0.0);
        vec3 seen = base * diffuse * (0.6 + 0.4 * also.y) + 0.8 * shine(n, l, v, gloss) * also.y;
        lit += light_colour[i] / d2 * share[i] * seen;
    }}
    colour = tone(lit);
}}
"""

EYE_FRAGMENT: Final = f"""{_HEAD}
uniform sampler2D eye_map;
uniform vec3 iris;

void main() {{
    vec3 v = normalize(-point), n = normalize(facing);
    vec3 base = texture(eye_map, place).rgb;
    base *= base;
    float r = length(place - vec2(0.5));
    base *= mix(iris, vec3(0.78, 0.74, 0.72), smoothstep(0.17, 0.19, r));
    float open = smoothstep(-0.75, 0.1, look.x) * 0.65 + 0.2;  // lids and lashes shade the upper part
    vec4 share = reached(point, n);
    vec3 lit = base * around(n, open, base);
    for (int i = 0; i < light_count; ++i) {{
        vec3 to_light = light_position[i] - point;
        float d2 = dot(to_light, to_light);
        vec3 l = to_light * inversesqrt(d2);
        vec3 diffuse = vec3(max((dot(n, l) + 0.2) / 1.44, 0.0));
        lit += light_colour[i] / d2 * mix(0.5, 1.0, share[i]) * (base * diffuse * open + 1.5 * shine(n, l, v, 0.22));
    }}
    colour = tone(lit);
}}
"""

CLOTH_FRAGMENT: Final = f"""{_HEAD}
{_CUT}
uniform vec3 albedo[{FABRICS}], second[{FABRICS}];
uniform vec4 weave[{FABRICS}];  // kind, period in metres, turn, contrast
uniform vec3 finish[{FABRICS}];  // wrinkles, roughness, whether the user's tile covers it
uniform sampler2D wrinkles;  // slope along the map, slope across, depth
uniform sampler2D tile, motifs;
uniform mat2 tiling;
uniform vec3 tile_mean;

// Where a band of half width `share` covers x, with period 1, softened by the pixel's size.
float band(float x, float share) {{
    float w = max(fwidth(x), 1e-4), d = abs(fract(x) - 0.5);
    return mix(smoothstep(share + w, share - w, d), 2.0 * share, smoothstep(0.3, 0.8, w));
}}

vec3 woven(int z, vec2 at, vec3 rest) {{
    vec3 a = albedo[z], b = second[z];
    float kind = weave[z].x, c = cos(weave[z].z), s = sin(weave[z].z);
    vec2 q = mat2(c, -s, s, c) * at / weave[z].y;
    float share = 0.0;
    if (kind < 0.5) share = 0.0;
    else if (kind < 1.5) share = band((weave[z].z > 0.5 ? at.x : look.y) / weave[z].y, 0.22);
    else if (kind < 2.5) share = 0.5 * (band(q.x, 0.25) + band(q.y, 0.25));
    else if (kind < 3.5) share = 0.35 * (band(q.x, 0.18) + band(q.y, 0.18))
                               + 0.3 * (band(q.x + 0.31, 0.025) + band(q.y + 0.31, 0.025));
    else if (kind < 4.5) {{
        vec2 cell = fract(q + vec2(0.5 * floor(mod(q.y, 2.0)), 0.0)) - 0.5;
        float w = max(fwidth(q.x) + fwidth(q.y), 1e-4);
        share = mix(smoothstep(0.28 + w, 0.28 - w, length(cell)), 0.25, smoothstep(0.3, 0.8, w));
    }}
    else if (kind < 5.5) share = noise(vec3(at * vec2(900.0, 260.0), seed.x)) * 0.6;
    else if (kind < 6.5) share = 0.35 * noise(vec3(at * vec2(700.0, 240.0), 1.0))
                               + 0.5 * smoothstep(0.35, 0.9, noise(rest * 7.0 + seed));
    else if (kind > 7.5) {{  // printed on the chest: period is its size, turn its number
        vec2 c = vec2(-rest.x, rest.y - 0.37) / weave[z].y + 0.5;
        vec2 cell = vec2(mod(weave[z].z, 4.0), floor(weave[z].z / 4.0));
        float on = float(min(min(c.x, c.y), min(1.0 - c.x, 1.0 - c.y)) > 0.01 && rest.z > -0.12);
        share = on * texture(motifs, (cell + clamp(c, 0.01, 0.99)) / 4.0).r;
    }}
    else {{
        float f = noise(vec3(q * 1.3, seed.y)) + 0.5 * noise(vec3(q * 3.1, seed.z));
        share = smoothstep(0.72, 0.76, f);
    }}
    vec3 out_colour = mix(a, b, share * weave[z].w);
    if (finish[z].z > 0.5) {{
        vec3 thread = texture(tile, tiling * at).rgb;
        out_colour = albedo[z] * thread * thread / tile_mean;
    }}
    return out_colour;
}}

void main() {{
    cut_sleeve(look.x);
    vec3 v = normalize(-point), n = normalize(facing);
    float soft = finish[zone].x;
    vec2 at = place;
    vec4 fold = texture(wrinkles, at * 1.7 + seed.xy);
    vec4 fine = texture(wrinkles, at.yx * 5.3 + seed.yz);
    mat3 frame = tangents(n, at);
    vec2 slope = soft * look.z * ((fold.xy - 0.5) * 2.0 + 0.3 * (fine.xy - 0.5));
    n = normalize(n - frame[0] * slope.x - frame[1] * slope.y);
    float towards = dot(n, v);
    if (towards < 0.05) n = normalize(n + (0.05 - towards) * v);
    float cavity = 1.0 - soft * look.z * 0.5 * fold.z;

    vec3 base = woven(zone, at, at_rest);
    float blotch = noise(at_rest * 26.0 + seed) - 0.5;
    float grain = grains((at_rest + seed) * 620.0 + 5.0 * blotch);
    base *= 1.0 + 0.12 * blotch + 0.22 * grain;
    if (sleeve_from > 0.0) base *= 0.72 + 0.28 * smoothstep(0.0, 0.035, look.x - sleeve_from);
    float open = also.y * cavity;
    vec4 share = reached(point, n);
    vec3 lit = base * around(n, open, base);
    float graze = pow(1.0 - max(dot(n, v), 0.0), 3.0);  // fuzz
    for (int i = 0; i < light_count; ++i) {{
        vec3 to_light = light_position[i] - point;
        float d2 = dot(to_light, to_light);
        vec3 l = to_light * inversesqrt(d2);
        float diffuse = max((dot(n, l) + 0.12) / 1.25, 0.0);
        vec3 seen = base * diffuse * (1.0 + 0.5 * graze) + 0.7 * shine(n, l, v, finish[zone].y);
        lit += light_colour[i] / d2 * share[i] * seen * (0.35 + 0.65 * open);
    }}
    colour = tone(lit);
}}
"""

INSIDE_FRAGMENT: Final = f"""
#version 330
uniform vec3 albedo[{FABRICS}];
uniform vec3 sky, ground;
in vec4 look;
flat in int zone;
out vec4 colour;
{_CUT}
{TONE}
void main() {{
    cut_sleeve(look.x);
    colour = tone(0.3 * albedo[zone] * (sky + ground));
}}
"""
"""The inside of sleeves, collars and skirts, which little light reaches."""

HAIR_FRAGMENT: Final = f"""{_HEAD}
{_STRANDS}
uniform vec3 hair_albedo;
uniform float white;

void main() {{
    vec4 fine = strand(look);
    vec3 v = normalize(-point), n = normalize(facing);
    if (dot(n, v) < 0.0) n = -n;
    mat3 frame = tangents(n, look.xy);
    vec3 t = normalize(frame[1] + 0.5 * (fine.z - 0.5) * frame[0] + 1e-4 * n);
    vec3 base = mix(hair_albedo, vec3(0.42, 0.41, 0.40), white * mix(0.55 + 0.6 * fine.x, 1.0, white * white));
    base *= (0.4 + 1.1 * fine.x) * (0.86 + 0.28 * fine.w);
    base *= 0.75 + 0.5 * smoothstep(0.0, 0.9, look.y) * (0.5 + dot(hair_albedo, vec3(0.5)));  // tips are lighter
    n = normalize(n + 0.45 * (fine.z - 0.5) * frame[0]);
    float open = also.y * (0.55 + 0.45 * fine.x);
    vec4 share = reached(point, n);
    vec3 lit = base * around(n, open, base);
    for (int i = 0; i < light_count; ++i) {{
        vec3 to_light = light_position[i] - point;
        float d2 = dot(to_light, to_light);
        vec3 l = to_light * inversesqrt(d2), h = normalize(l + v);
        float diffuse = max((dot(n, l) + 0.25) / 1.56, 0.0);
        float th = dot(t, h) + 0.12 * (fine.z - 0.5) + 0.06, th2 = dot(t, h) - 0.08;
        float sheen = 0.05 * pow(max(1.0 - th * th, 0.0), 60.0);
        vec3 second_sheen = 0.35 * base * pow(max(1.0 - th2 * th2, 0.0), 16.0);
        float lobe = smoothstep(-0.1, 0.4, dot(n, l));
        vec3 seen = base * diffuse + lobe * (sheen * (0.4 + fine.x) + second_sheen);
        lit += light_colour[i] / d2 * share[i] * open * seen;
    }}
    colour = tone(lit);
}}
"""

CARD_FRAGMENT: Final = f"""{_HEAD}
uniform sampler2D card_map;
uniform vec3 card_albedo;
uniform float strength;

void main() {{
    float alpha = texture(card_map, place).a * strength;
    vec3 n = normalize(facing), v = normalize(-point);
    if (dot(n, v) < 0.0) n = -n;
    vec3 lit = card_albedo * around(n, 0.8, card_albedo);
    for (int i = 0; i < light_count; ++i) {{
        vec3 to_light = light_position[i] - point;
        float d2 = dot(to_light, to_light);
        lit += light_colour[i] / d2 * card_albedo * max((dot(n, to_light * inversesqrt(d2)) + 0.3) / 1.69, 0.0);
    }}
    colour = vec4(tone(lit).rgb, 1.0) * vec4(vec3(1.0), clamp(alpha, 0.0, 1.0));
}}
"""
