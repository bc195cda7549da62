#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""Real pictures of ../shared: what gieson makes of them, beside colour deconvolution as QuPath does
it (Ruifrok's, with given vectors, a white of 255 and a threshold).

    real_images.py BIN TEST_PROGRAMS    the programs' folders

The mask of the picrosirius tile was made by its authors' colour threshold, so agreement with it is a
sanity check and not a truth. Without ../shared it says so and ends with 77."""
import importlib.util
import json
import os
import pathlib
import subprocess
import sys
import tempfile

SKIPPED = 77
DEBIANS = "/usr/bin/python3"
ROOT = pathlib.Path(__file__).resolve().parents[2]
SHARED = pathlib.Path(os.environ.get("GIESON_SHARED", ROOT.parent / "shared"))
# Picro dyes on glass as gieson has them built in, red then yellow.
VECTORS = ((0.239, 0.716, 0.655), (0.357, 0.326, 0.875))


def otsu(numpy, values):
    count, edges = numpy.histogram(values, bins=256)
    middle = (edges[1:] + edges[:-1]) / 2
    below = numpy.cumsum(count)
    above = count.sum() - below
    first = numpy.cumsum(count * middle)
    between = numpy.zeros(256)
    inside = (below > 0) & (above > 0)
    between[inside] = (below * above * (first / numpy.maximum(below, 1) - (first[-1] - first) /
                                        numpy.maximum(above, 1)) ** 2)[inside]
    return middle[between.argmax()]


def dice(ours, theirs):
    return 2 * (ours & theirs).sum() / (ours.sum() + theirs.sum())


def deconvolved(colour):
    """Lines of what deconvolution says of the picrosirius tile; None without numpy."""
    try:
        import numpy
        from PIL import Image
    except ImportError:
        return None
    rgb = numpy.asarray(Image.open(colour / "psr_left.jpg").convert("RGB"), dtype=float)
    mask = numpy.asarray(Image.open(colour / "psr_left_mask.jpg").convert("L")) > 127
    density = -numpy.log10(numpy.maximum(rgb, 1) / 255)
    red, yellow = (numpy.array(v) / numpy.linalg.norm(v) for v in VECTORS)
    third = numpy.cross(red, yellow)
    amounts = density @ numpy.linalg.inv(numpy.stack([red, yellow, third / numpy.linalg.norm(third)]))
    amount = amounts[..., 0]
    blind = otsu(numpy, amount[density.sum(axis=2) > 0.3])
    told = max(numpy.linspace(amount.min(), amount.max(), 200),
               key=lambda t: dice(amount > t, mask) if (amount > t).any() else 0)
    return [f"deconvolution, {how}: Dice {dice(amount > t, mask):.3f}, "
            f"area {100 * (amount > t).mean():.2f} % (mask {100 * mask.mean():.2f} %)"
            for how, t in (("Otsu's threshold", blind), ("the best of all thresholds", told))]


def retouched(numpy, image, light=1.0, stain=1.0):
    """The picture in this light and of a stain this strong, as sRGB of 8 bits."""
    code = numpy.asarray(image, dtype=float) / 255
    linear = numpy.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)
    white = numpy.percentile(linear, 99.5, axis=(0, 1))
    linear = numpy.clip(light * white * (numpy.maximum(linear, 1e-4) / white) ** stain, 0, 1)
    coded = numpy.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return numpy.round(255 * coded).astype(numpy.uint8)


def moved(call, folder, colour):
    """What light, compression and the stain's strength do to the mean of the picrosirius tile; None
    without numpy, else whether it is as promised."""
    try:
        import numpy
        from PIL import Image
    except ImportError:
        return None
    image = Image.open(colour / "psr_left.jpg").convert("RGB")
    made = {"as_is": {}, "light09": {"light": 0.9}, "light11": {"light": 1.1}, "stain12": {"stain": 1.2}}
    for name, how in made.items():
        Image.fromarray(retouched(numpy, image, **how)).save(f"{folder}/{name}.png")
    for quality in (85, 50):
        image.save(f"{folder}/jpeg{quality}.jpg", quality=quality)
    pictures = [f"{name}.png" for name in made] + ["jpeg85.jpg", "jpeg50.jpg"]
    for picture in pictures:
        call("import", "--tile", f"{folder}/{picture}")
    call("run")
    found = {picture: json.loads(call("report", picture[:-4], "--json").stdout)["tile"]
             for picture in pictures}
    first, fine = found["as_is.png"], True
    for picture, tile in found.items():
        moves = tile["mean_density"] / first["mean_density"] - 1
        shares = tile["red_share"] / first["red_share"] - 1
        inside = tile["mean_density_lower"] <= first["mean_density"] <= tile["mean_density_upper"]
        print(f"picrosirius, {picture[:-4]}: mean {tile['mean_density']:.3f} "
              f"({tile['mean_density_lower']:.3f} to {tile['mean_density_upper']:.3f}), "
              f"{100 * moves:+.1f} %; share of red {100 * shares:+.1f} %")
        fine &= abs(shares) <= 0.03
        fine &= abs(moves - 0.2) <= 0.03 if picture == "stain12.png" else abs(moves) <= 0.03 and inside
    return fine


def main():
    programs, tests = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2])
    colour = SHARED / "data" / "colour"
    if not colour.is_dir():
        print(f"SKIPPED: {colour} is not there")
        return SKIPPED
    wrong = []
    with tempfile.TemporaryDirectory(prefix="gieson-real-") as folder:
        def call(*arguments):
            return subprocess.run([programs / "gieson", "-s", folder + "/store", *arguments],
                                  capture_output=True, text=True, timeout=600)

        call("import", "--tile", colour / "psr_left.jpg", "--reference", "psr_left_mask.jpg",
             "--specimen", "psr")
        call("import", "--tile", colour / "he_liver_tile01.jpg", "--specimen", "he")
        call("run")
        mask = json.loads(call("report", "psr", "--json").stdout)["tile"]["mask"]
        print(f"picrosirius, gieson: Dice {mask['dice']:.3f}, area {100 * mask['map_fraction']:.2f} % "
              f"(mask {100 * mask['mask_fraction']:.2f} %)")
        for line in deconvolved(colour) or ["deconvolution: SKIPPED, python3-numpy or -pil is missing"]:
            print("picrosirius,", line)
        if not mask["dice"] >= 0.8:
            wrong.append("the picrosirius tile")
        if moved(call, folder, colour) is False:
            wrong.append("light, compression and stain of the picrosirius tile")
        said = call("show", "he").stdout + call("status").stdout
        refused = "does not look like Van Gieson" in " ".join(said.split())
        print("haematoxylin and eosin:", "refused, does not look like Van Gieson" if refused
              else said)
        if not refused:
            wrong.append("haematoxylin and eosin")
    slides = subprocess.run([tests / "test_specimen_slides"], capture_output=True, text=True)
    for line in (slides.stdout + slides.stderr).splitlines():
        if not line.startswith("["):
            print(line)
    if slides.returncode not in (0, SKIPPED):
        wrong.append("pen, empty glass or coverslip edge")
    print("wrong: " + ", ".join(wrong) if wrong else "all as it must be")
    return 1 if wrong else 0


if __name__ == "__main__":
    # Debian's own interpreter has Debian's numpy.
    if importlib.util.find_spec("numpy") is None and os.access(DEBIANS, os.X_OK) and \
            not os.path.samefile(sys.executable, DEBIANS):
        os.execv(DEBIANS, [DEBIANS, *sys.argv])
    sys.exit(main())
