# The peer of `cargo run --release -p marf-labs -- stereo DIR`: OpenCV StereoSGBM, MODE_HH, on the same pairs of DIR.
import os, resource, sys, time
import cv2, numpy as np
root = sys.argv[1]
def pfm(path):
    with open(path, "rb") as f:
        f.readline(); w, h = map(int, f.readline().split()); scale = float(f.readline())
        return np.frombuffer(f.read(), "<f4" if scale < 0 else ">f4").reshape(h, w)[::-1]
def grey(name): return cv2.imread(os.path.join(root, name), 0)
def hh(count): return cv2.StereoSGBM_create(0, count, 5, 200, 800, 1, 0, 10, 100, 2, 1)
PAIRS = [("cones", "cones/im2.png", "cones/im6.png", "cones/disp2.png", 4, 64),
         ("teddy", "teddy/im2.png", "teddy/im6.png", "teddy/disp2.png", 4, 64),
         ("Cloth3", "Cloth3/view1.png", "Cloth3/view5.png", "Cloth3/disp1.png", 2, 128),
         ("aloe", "aloeL.jpg", "aloeR.jpg", "aloeGT.png", 1, 256),
         ("playground", "playground/im0.png", "playground/im1.png", "playground/disp0.pfm", 1, 64)]
rows = []
for name, left, right, truth, scale, count in PAIRS:
    left, right = grey(left), grey(right)
    truth = pfm(os.path.join(root, truth)) if truth.endswith("pfm") else grey(truth).astype(np.float32) / scale
    known = np.isfinite(truth) & (truth > 0)
    cpu = time.process_time(); d = hh(count).compute(left, right).astype(np.float32) / 16; cpu = time.process_time() - cpu
    valid = known & (d >= 0); error = np.abs(d - truth)[valid]; x = d[valid]
    rows.append((valid.sum() / known.sum(), (error <= 1).sum() / known.sum(), (error > 1).mean(),
                 np.sqrt((error[error <= 1] ** 2).mean()), (np.abs(x - np.round(x)) <= 0.125).mean(), cpu))
    print("| HH | %s | %.3f | %.3f | %.3f | %.3f | %.3f | %.2f |" % (name, *rows[-1]))
print("| HH | mean | %.3f | %.3f | %.3f | %.3f | %.3f | %.2f |" % tuple(np.mean(rows, axis=0)))
big = [cv2.resize(grey(n), (1648, 1200)) for n in ("aloeL.jpg", "aloeR.jpg")]
cv2.setNumThreads(1); cpu = time.process_time(); hh(256).compute(*big)
print("| HH | 1648x1200x256 | CPU s %.2f | peak MiB %d |" % (time.process_time() - cpu, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024))
