"""An avatar of the user's own hand, from one film of a telephone or a few photographs.

film    the film or the photographs: looked at, the best pictures chosen and read
start   what the tracker says of these pictures: where all that follows begins
masks   which pixels are the hand, without its forearm
checks  what is wrong with a film, in sentences
chain   the bones whose lengths are sought, in torch
shape   what hands differ in beyond their bones: a basis, and an avatar in a shape
hand_fit     bones, thickness and motion that explain the film: by the detector alone, then by pictures
fit_terms    what that weighs beside pictures · fit_views, fit_surface, fit_colors: what it draws
exact   the motion of all pictures, by the hand that the best ones gave
gather  what each picture shows of every Gaussian
light_and_skin  the light of the film, and the albedo of what was seen: the avatar
skin_prior      skin that no picture shows
detail  what Gaussians cannot hold of the skin: its texture
report  pictures of the film that were held out, what was seen, a sheet
make    all of it, stage by stage, in a work folder that a stopped run goes on from
"""
