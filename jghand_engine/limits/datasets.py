"""Limits of data sets."""

from __future__ import annotations

# ---- datasets -------------------------------------------------------------------------------------------------------
# gray value of a mask file from which a pixel is hand: JPEG smears the edge over some pixels around the middle
MASK_THRESHOLD = 128
# samples per pixel edge when a template is projected: steps of 1/16 in the coverage of a pixel
MASK_SUPERSAMPLING = 4
# gray values between which the avatar papers take a pixel of a projected mask for skin (METHOD 6.1)
PAPER_MASK_GRAY = (10, 200)
# the same papers leave a picture out when the hand's box is nearer to the border than this or smaller, pixels; when it
# is as dark as this; when two color channels differ nowhere by more than this; when the mask has fewer pixels
PAPER_BORDER_PX = 10
PAPER_BOX_MIN_PX = 80
PAPER_DARK = 20
PAPER_CHANNEL_DIFFERENCE = 1
PAPER_MASK_MIN_PX = 3000
# width and height of HanCo's pictures
HANCO_SIZE_PX = (224, 224)
HANCO_CAMERAS = 8
# last bytes of a picture file in which its end mark must stand; some cameras pad the file behind it
PICTURE_TAIL_BYTES = 64
# by how much a stored camera rotation may fail to be one: text with six digits
CAMERA_ROTATION_TOLERANCE = 1e-4
# ... and the skew of a camera that is taken for none, px: none of the data sets has any
CAMERA_SKEW_MAX_PX = 1e-3
# the rule by which a set without a split of its own is split: every n-th pose and every n-th camera is for the test
SPLIT_EVERY_POSE = 5
SPLIT_EVERY_CAMERA = 6
# check-data looks at so many pictures of a larger set, and names so many examples of what is wrong
CHECK_PICTURES = 400
CHECK_EXAMPLES = 8
# pictures on which it tries out which mistake would explain joints beside the hand
CHECK_MISTAKE_PICTURES = 24
# a joint so near to the mask counts as on it, px: joints lie inside the finger, its silhouette may be cut close
CHECK_REACH_PX = 3
# part of the joints on the mask below which a picture is named, and, as the median over all, the set refused; masks
# that leave out what an object hides have less than 1
CHECK_ON_MASK_PICTURE_MIN = 0.7
CHECK_ON_MASK_MIN = 0.85
# a mask with fewer pixels is empty, one that covers more of its picture is most likely inverted or of something else
CHECK_MASK_MIN_PX = 50
CHECK_MASK_MAX = 0.9
# variation of a bone's length, standard deviation over mean, above which joints are told to be noisy (triangulated
# ones of real sets vary by a few per cent)
CHECK_BONE_WOBBLE = 0.08
# mean bend of the fingers' middle joints away from the palm, as a sine, from which it must be the other hand
CHECK_CURL = 0.1
# overlay pictures: enlargement, and how far outside of the picture lines are still drawn, px
OVERLAY_ZOOM = 2
OVERLAY_REACH_PX = 20_000
# folders between the one that the user names and the one that holds the set, upwards and downwards
FOLDER_LEVELS_UP = 6
FOLDER_LEVELS_DOWN = 2

# ---- datasets: motions of other programs ----------------------------------------------------------------------------
# text of one value of a JSON file, bytes: a frame with face, body and both hands, indented, has 200 kB
JSON_ELEMENT_MAX_BYTES = 1 << 20
# how much of its text is looked at for one value, bytes, growing by so much until it is enough: most are short. Text
# whose values nobody asks for is skipped in blocks, which make some arrays of eight times their size
JSON_LOOK_BYTES = 1 << 8
JSON_LOOK_GROWTH = 8
JSON_BLOCK_BYTES = 1 << 17
# names of the outermost object of a JSON file, and frames in which a hand is looked for before the file is given up
JSON_NAMES_MAX = 4096
RECOGNIZE_JSON_FRAMES = 5000
# the same for a buffer that a glTF file holds as text
JSON_BUFFER_MAX_BYTES = 1 << 28
# nodes, accessors, channels of a glTF file, joints of a BVH file; film rigs have some thousands
RIG_PARTS_MAX = 65_536
# bones above the hands of a file: a film rig has some tens above each
RIG_DEPTH_MAX = 1024
# the description in a GLB, bytes: a rig with meshes, materials and some actions has some hundred kB
GLTF_JSON_MAX_BYTES = 1 << 26
# characters of a line of text: a whole body with its face has 40 kB, a film rig in BVH 100 kB
TEXT_LINE_MAX = 1 << 19
# lines of the header of a BVH file
BVH_HEADER_LINES_MAX = 1 << 20
# positions of a joint in BVH smaller than this part of its offset are moves from there, not its place
BVH_ADDED_MAX = 0.25
# a body in BVH that is so much longer along z than along y stands along z
BVH_Z_UP_MIN = 2.0
# lines of motion that are turned into numbers at once
BVH_LINES_AT_ONCE = 64
# frames whose bones are turned into joints at once: 60 bones of 4096 frames have 30 MB
SKELETON_FRAMES_AT_ONCE = 4096
# bones of wrist and fingers, of 16, from which names count as a hand that lacks some
BONES_RECOGNIZED_MIN = 8
# length of a finger's last bone, skin included, over that of the bone before it, thumb to little finger: lengths of
# phalanges and of the pulp of Buryanov and Kotiuk, Proportions of Hand Segments (2010)
TIP_RATIOS = (0.80, 0.88, 0.81, 0.83, 1.09)
# how far the bones of a hand may lie from one axis of their joints, degrees, for it to be the rig's bone axis
BONE_AXIS_MAX_DEG = 12.0
# frames per second of a clock whose unit is not said; they tell seconds from milliseconds and microseconds
CLOCK_FPS_MIN = 1.5
CLOCK_FPS_MAX = 1000.0
# part of a step by which frames may miss even times, either way, and still come evenly; steps between keys, their mean
STEP_JITTER_MAX = 0.1
# ... or this, where it is more: clocks in whole milliseconds round
CLOCK_TICK_S = 1e-3
# part of a millisecond by which a time may miss a whole one: round-off of seconds since 1970 in double precision
CLOCK_TICK_EPS = 1e-3
# steps of a clock that differ from their median by less than this part of it count for the rate: not one of two frames
STEP_USUAL = 1 / 3
# steps of an uneven clock up to so many medians make its rate: pages show a camera's frames after two or three
# of their pictures, which is 1.5; a frame that was dropped makes it 2
STEP_UNEVEN_MAX = 1.75
# part of the frames that must have a time that rises for a clock to be used
CLOCK_KNOWN_MIN = 0.5
# steps of a clock longer than so many usual ones are holes: nobody saw what is in them
CLOCK_HOLE_STEPS = 1.5
# part by which a measured rate may miss a whole one: half of what 30000 / 1001 is from 30
WHOLE_RATE_EPS = 5e-4
# rates of animations whose keys do not come evenly: the first on whose frames nearly all keys lie
USUAL_FPS = (30.0, 24.0, 25.0, 60.0, 50.0, 48.0, 90.0, 72.0, 120.0, 100.0, 144.0, 240.0)
# part of a frame by which a key may miss one (times in single precision), and part of the keys that may lie elsewhere
KEY_FRAME_EPS = 0.05
KEYS_OFF_MAX = 0.05
# seconds by which key times must differ to be two: single precision has 6e-5 after a quarter of an hour
KEYS_APART_MIN_S = 2e-4
# keys that come more seldom are poses, no frames; a rate above the other is none
KEYS_FPS_MIN = 6.0
KEYS_FPS_MAX = 240.0
# frames of a motion for each time of a key or a clock, and seconds beyond that: two an hour apart are a mistake
KEYS_APART_MAX = 64
KEYS_S_MAX = 600.0
# part of the way to the next key of glTF by which a frame may miss it
KEY_EPS = 1e-3
# frames in which joint order and size are looked for: a hand's bones do not change
RECOGNIZE_FRAMES = 500
# bytes from which the format of a file is recognized
RECOGNIZE_BYTES = 1 << 16
# frames of InterHand2.6M that may be left out before it is another sequence: a second
INTERHAND_GAP_STEPS = 30
# points of a whole body of FreeMoCap: body, right hand, left hand, and the face if it was tracked
FREEMOCAP_BODY_POINTS = 33
# points of a face: none, its outline, MediaPipe's mesh without and with irises
FREEMOCAP_FACE_POINTS = (0, 136, 468, 478)
# points that early ones of version 2 add to a body: centers of head, neck, trunk and hips
FREEMOCAP_CENTERS = 4
# names of points in a table with a line for each: body, hands and face have 553
JOINT_LINES_NAMES_MAX = 2000
# memory that the frames of such a table may take besides twice the size of the file: FreeMoCap leaves none out
JOINT_LINES_FREE_BYTES = 1 << 20
# characters of a frame's number: 64 bits have 20, a sign and a fraction
FRAME_NUMBER_CHARACTERS_MAX = 24
