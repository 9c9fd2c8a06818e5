"""Opens an export with a public reader; prints one JSON object.

usage: read.py cameras FOLDER | ply FILE | safetensors FILE
"""
import json, pathlib, shutil, sys, tempfile

import numpy


def model(folder, ending):
    """Reads COLMAP's model of one form alone: the reader prefers the binary one."""
    import pycolmap

    with tempfile.TemporaryDirectory() as alone:
        for name in ("cameras", "images", "points3D"):
            shutil.copy(folder / "sparse/0" / f"{name}.{ending}", alone)
        return pycolmap.Reconstruction(alone)


def cameras(folder):
    """Largest difference between the poses and lenses of both forms and of transforms.json."""
    binary, text = model(folder, "bin"), model(folder, "txt")
    transforms = json.loads((folder / "transforms.json").read_text())
    frames = {pathlib.Path(frame["file_path"]).name: frame for frame in transforms["frames"]}
    worst, missing = 0.0, []
    for number, image in binary.images.items():
        pose = image.cam_from_world().matrix()
        lens = numpy.array(binary.cameras[image.camera_id].params)
        other = text.images[number]
        frame = frames[pathlib.Path(image.name).name]
        # OpenGL's axes of a camera: y up, z backwards.
        world_from_cam = numpy.array(frame["transform_matrix"]) * [1, -1, -1, 1]
        own = [frame.get(key, transforms.get(key)) for key in ("fl_x", "fl_y", "cx", "cy")]
        differences = [
            pose - other.cam_from_world().matrix(),
            lens - numpy.array(text.cameras[other.camera_id].params),
            pose - numpy.linalg.inv(world_from_cam)[:3],
            lens[:4] - own if len(lens) >= 4 else lens[[0, 0, 1, 2]] - own,
        ]
        worst = max([worst] + [float(numpy.abs(difference).max()) for difference in differences])
        if image.name != other.name or not (folder / frame["file_path"]).is_file():
            missing.append(image.name)
    return {
        "images": len(binary.images),
        "text_images": len(text.images),
        "frames": len(frames),
        "points": [len(binary.points3D), len(text.points3D)],
        "worst": worst,
        "missing": missing,
    }


def ply(path):
    import plyfile

    data = plyfile.PlyData.read(path)
    vertex = data["vertex"]
    columns = {name: numpy.asarray(vertex[name], dtype=float) for name in vertex.data.dtype.names}
    return {
        "properties": list(columns),
        "vertices": len(vertex.data),
        "faces": len(data["face"].data) if "face" in data else 0,
        "finite": all(bool(numpy.isfinite(column).all()) for column in columns.values()),
        "range": {name: [float(column.min()), float(column.max())] for name, column in columns.items()},
        "rotation_off": float(abs(sum(columns[f"rot_{part}"] ** 2 for part in range(4)) - 1).max()) if "rot_0" in columns else 0,
        "comments": data.comments,
    }


def safetensors(path):
    import safetensors

    with safetensors.safe_open(path, framework="numpy") as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}
        metadata = file.metadata() or {}
    return {
        "tensors": {name: list(tensor.shape) for name, tensor in tensors.items()},
        "finite": all(bool(numpy.isfinite(tensor).all()) for tensor in tensors.values()),
        "metadata": sorted(metadata),
    }


print(json.dumps(globals()[sys.argv[1]](pathlib.Path(sys.argv[2]))))
