#!/usr/bin/env python3
"""Irradiance at points by RADIANCE's programs and by `radiosity probe`, on five scenes, and a year of daylight.

usage: compare.py PROGRAM [SCENE ...]              PROGRAM: target/release/radiosity
       compare.py PROGRAM --year [WEATHER.epw]     without a file: made weather of Munich's latitude
Needs the packages pyradiance and numpy (pip). Prints the largest and the RMS relative difference of each scene, and ends
with status 1 if any point differs by more than 1 %, or the mean illuminance of a year at any point by more than 5 % from that of
RADIANCE with the suns in their places."""
import math, os, pathlib, subprocess, sys, tempfile, time
import numpy as np
import pyradiance
BIN = pathlib.Path(pyradiance.__file__).parent / "bin"
LIB = pathlib.Path(pyradiance.__file__).parent / "lib"

def quad(c, u, v):
    add = lambda *p: tuple(sum(x) for x in zip(*p))
    return [c, add(c, u), add(c, u, v), add(c, v)]

def court():
    """A court, 4 m wide, with two walls and a block: z up."""
    b = lambda x0, x1, y0, y1, h: [
        quad((x0, y0, h), (x1-x0, 0, 0), (0, y1-y0, 0)), quad((x0, y0, 0), (x1-x0, 0, 0), (0, 0, h)),
        quad((x1, y0, 0), (0, y1-y0, 0), (0, 0, h)), quad((x1, y1, 0), (x0-x1, 0, 0), (0, 0, h)),
        quad((x0, y1, 0), (0, y0-y1, 0), (0, 0, h))]
    faces = [(quad((-2, -2, 0), (4, 0, 0), (0, 4, 0)), .3), (quad((-2, 2, 0), (0, 0, 1.5), (4, 0, 0)), .7),
             (quad((-2, -2, 0), (0, 0, 1.5), (0, 4, 0)), .5)]
    return faces + [(f, .6) for f in b(-.4, .2, -.3, .3, .8)]

def room():
    """A room of 4 x 3 x 2.5 m with a window in its south wall."""
    x, y, z = 4, 3, 2.5
    w = [(quad((0, 0, 0), (x, 0, 0), (0, y, 0)), .2), (quad((0, 0, z), (0, y, 0), (x, 0, 0)), .8),
         (quad((0, y, 0), (0, 0, z), (x, 0, 0)), .5), (quad((0, 0, 0), (0, y, 0), (0, 0, z)), .5),
         (quad((x, 0, 0), (0, 0, z), (0, y, 0)), .5)]
    s = lambda x0, x1, z0, z1: (quad((x0, 0, z0), (0, 0, z1-z0), (x1-x0, 0, 0)), .5)
    return w + [s(0, 1, 0, z), s(3, x, 0, z), s(1, 3, 0, .9), s(1, 3, 2.2, z)]

def plane():
    return [(quad((-5, -5, 0), (10, 0, 0), (0, 10, 0)), .0)]

COURT = [(x, y, 0.001, 0, 0, 1) for x, y in ((1, 1), (-1, .8), (.6, -.9), (-1.5, -1.5), (1.5, 0))] + [(-1, 1.999, .8, 0, -1, 0)]
ROOM = [(x, y, .8, 0, 0, 1) for x, y in ((2, .5), (2, 1.5), (2, 2.7), (.4, 1.5), (3.6, 2.5))]
IES = "IESNA:LM-63-2002\nTILT=NONE\n1 -1 1 46 1 1 2 -0.2 -0.2 0\n1 1 10\n" + " ".join(str(a) for a in range(0, 91, 2)) + "\n0\n" + \
      " ".join("%.6g" % (100*math.cos(math.radians(a))) for a in range(0, 91, 2)) + "\n"
# Sky functions of RADIANCE's programs without the ground that they blend into the horizon.
CAL = """mycloudy = A2*(1+2*Dz)/3;
cosgamma = Dx*A5+Dy*A6+Dz*A7;
myclear = A2*(.91+10*exp(-3*Acos(cosgamma))+.45*cosgamma*cosgamma)*if(Dz-.01,1-exp(-.32/Dz),1)/A4;
pg = Dx*A8+Dy*A9+Dz*A10;
myperez = A1*(1+A3*exp(A4/if(Dz-.01,Dz,.01)))*(1+A5*exp(A6*Acos(pg))+A7*pg*pg);
"""

ENV = dict(os.environ, PATH=f"{BIN}:{os.environ['PATH']}", RAYPATH=f".:{LIB}")

def run(words, text=None, cwd=None):
    done = subprocess.run(words, input=text, capture_output=True, text=True, cwd=cwd, env=ENV)
    if done.returncode:
        sys.exit(f"{words}: {done.stderr}")
    return done.stdout

def numbers(text, name):
    """The arguments of a primitive of this name in a scene of RADIANCE."""
    words = " ".join(line for line in text.splitlines() if not line.startswith("#")).split()
    k = words.index(name) + 1
    n = int(words[k]); k += n + 1
    k += int(words[k]) + 1
    return [float(x) for x in words[k+1:k+1+int(words[k])]]

def sky(kind, function):
    return f"void brightfunc skyfunc\n2 {function} my.cal\n0\n{kind}\nskyfunc glow g\n0\n0\n4 1 1 1 0\ng source sky\n0\n0\n4 0 0 1 180\n"

def sun_of(text):
    light, source = numbers(text, "solar"), numbers(text, "sun")
    return light, source, "void light solar\n0\n0\n3 %g %g %g\nsolar source sun\n0\n0\n4 %g %g %g %g\n" % (*light, *source)

def azimuth(d):
    return math.degrees(math.atan2(d[0], d[1])), math.degrees(math.asin(d[2]))

def overcast():
    text = run(["gensky", "-ang", "40", "0", "-c", "-B", "100"])
    a = numbers(text, "skyfunc")
    return sky("3 %g %g %g" % tuple(a[:3]), "mycloudy"), ["--sky", "overcast:100"]

def horizontal(sun, radiance, n=400):
    """Irradiance of a horizontal plane by a sky: radiance by the sine of the altitude, and the angle to the sun and its cosine."""
    total = 0
    for i in range(n):
        h = math.asin(math.sqrt((i+.5)/n)); s = math.sin(h)
        for j in range(n):
            p = 2*math.pi*(j+.5)/n
            c = sum(x*y for x, y in zip((math.cos(h)*math.cos(p), math.cos(h)*math.sin(p), s), sun))
            total += radiance(s, math.acos(max(-1, min(1, c))), c)
    return math.pi*total/n/n

def clear():
    text = run(["gensky", "-ang", "40", "30", "+s", "-B", "80"])
    a = numbers(text, "skyfunc")
    light, source, rad = sun_of(text)
    of_sun = light[0] * math.pi * math.sin(math.radians(source[3]/2))**2
    az, alt = azimuth(source[:3])
    # The irradiance of this sky without its ground, by the same integral as RADIANCE leaves to its renderer.
    e = horizontal(a[4:7], lambda s, g, c:
        a[1]*(.91+10*math.exp(-3*g)+.45*c*c)*((1-math.exp(-.32/s)) if s > .01 else 1)/a[3])
    return rad + sky("7 " + " ".join("%g" % x for x in a), "myclear"), \
        ["--sky", "clear:%.9g" % e, "--sun", "%.9g,%.9g,%.9g" % (az, alt, of_sun)]

def perez():
    text = run(["gendaylit", "-ang", "40", "30", "-W", "700", "120", "-O", "1"])
    a = numbers(text, "skyfunc")
    light, source, rad = sun_of(text)
    az, alt = azimuth(source[:3])
    e = a[0] * horizontal(a[7:10], lambda s, g, c:
        (1+a[2]*math.exp(a[3]/max(s, .01)))*(1+a[4]*math.exp(a[5]*g)+a[6]*c*c))
    print(f"gendaylit's sky sends {e:.2f} of 120 W/m2; RADIANCE's is scaled to 120", flush=True)
    a[0] *= 120/e
    light = [x * 700/(light[0]*math.pi*math.sin(math.radians(source[3]/2))**2) for x in light]
    rad = "void light solar\n0\n0\n3 %g %g %g\nsolar source sun\n0\n0\n4 %g %g %g %g\n" % (*light, *source)
    return rad + sky("10 " + " ".join("%g" % x for x in a), "myperez"), \
        ["--sky", "perez:700,120", "--sun", "%.9g,%.9g" % (az, alt)]

def ies():
    pathlib.Path("disc.ies").write_text(IES)
    run(["ies2rad", "-dm", "-o", "disc", "disc.ies"])
    text = run(["xform", "-t", "0", "0", "2", "disc.rad"])
    return text, ["--light", "disc.ies@0,0,2", "--luminous-efficacy", "179"]

# In the corner of the room results of one rtrace spread by 0.7 %.
REPEATS = 4
SCENES = {"court under an overcast sky": (court, COURT, overcast), "court under a clear sky with sun": (court, COURT, clear),
          "court under a sky of Perez": (court, COURT, perez), "room with a window, sky of Perez": (room, ROOM, perez),
          "disc of an IES file": (plane, [(x, .1, 0.0005, 0, 0, 1) for x in (0, .5, 1, 1.5, 2)], ies)}

def as_files(faces):
    """The same faces for RADIANCE, s.rad, and as OBJ, s.obj and s.mtl."""
    rad, obj, mtl, n = "", "mtllib s.mtl\n", "", 0
    for k, (face, rho) in enumerate(faces):
        rad += f"void plastic m{k}\n0\n0\n5 {rho} {rho} {rho} 0 0\nm{k} polygon f{k}\n0\n0\n12 " + " ".join("%g %g %g" % p for p in face) + "\n"
        mtl += f"newmtl m{k}\nKd {rho} {rho} {rho}\n"
        obj += f"usemtl m{k}\n" + "".join("v %g %g %g\n" % p for p in face) + "f %d %d %d %d\n" % tuple(range(n+1, n+5)); n += 4
    pathlib.Path("s.obj").write_text(obj); pathlib.Path("s.mtl").write_text(mtl)
    return rad

DAYS = [31, 28, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31]

def made_weather(latitude=48.0):
    """A year of clear, changing and overcast days as an EPW file, with solar time: hours end at their labels."""
    lines = ["LOCATION,made,-,-,made,0,%g,0.0,0.0,0.0" % latitude, "DESIGN CONDITIONS,0", "TYPICAL/EXTREME PERIODS,0",
             "GROUND TEMPERATURES,0", "HOLIDAYS/DAYLIGHT SAVINGS,No,0,0,0", "COMMENTS 1,made", "COMMENTS 2,made",
             "DATA PERIODS,1,1,Data,Sunday,1/1,12/31"]
    for number, (month, day) in enumerate((m+1, d+1) for m in range(12) for d in range(DAYS[m])):
        tilt = math.radians(-23.45 * math.cos(2*math.pi*(number+10)/365))
        for hour in range(1, 25):
            turn, phi = math.radians(15*(hour-.5-12)), math.radians(latitude)
            sine = math.sin(phi)*math.sin(tilt) + math.cos(phi)*math.cos(tilt)*math.cos(turn)
            direct = diffuse = 0
            if sine > .02:
                share = [1, .4, 0][(number*7 + hour*(number % 5)) % 3]
                direct, diffuse = 950*math.exp(-.16/sine)*share, sine*(110 + 160*(1-share))
            lines.append(f"2026,{month},{day},{hour},60,?9,15,8,50,101000,0,0,300,500,{direct:.1f},{diffuse:.1f},"
                         "0,0,0,0,180,2,5,5,20,7777,9,999999999,10,0.1,0,30,0.2,0,1")
    return "\n".join(lines) + "\n"

def coefficients(points, bounces):
    """Daylight coefficients of rfluxmtx for the ground and Reinhart's 2305 parts of the sky."""
    sky = "#@rfluxmtx h=u u=+Y\nvoid glow gg\n0\n0\n4 1 1 1 0\ngg source ground\n0\n0\n4 0 0 -1 180\n" \
          "#@rfluxmtx h=r4 u=+Y\nvoid glow sg\n0\n0\n4 1 1 1 0\nsg source sky\n0\n0\n4 0 0 1 180\n"
    pathlib.Path("sky.rad").write_text(sky)
    text = run(["rfluxmtx", "-I+", "-ab", str(bounces), "-ad", "65536", "-lw", "1e-7", "-n", "1", "-", "sky.rad", "s.rad"],
               pathlib.Path("p.txt").read_text())
    rows = [line for line in text.splitlines() if line and line[0] in "0123456789-+ \t"]
    values = np.array([float(x) for line in rows for x in line.split()])
    return values[-len(points)*2306*3:].reshape(len(points), 2306, 3)[:, :, 1]

# What RADIANCE counts as luminance: 179 lm/W times its weights of R, G and B.
LUMINANCE = [47.4, 119.9, 11.6]

def skies(*options):
    """The light of the ground and the 2305 parts of the sky in each hour, cd/m2."""
    out = subprocess.run(["gendaymtx", "-m", "4", "-h", "-of", "-g", "0", "0", "0", *options, "w.epw"], stdout=subprocess.PIPE,
                         stderr=subprocess.DEVNULL, check=True, env=ENV).stdout
    return np.frombuffer(out, dtype="<f4").reshape(2306, -1, 3) @ np.array(LUMINANCE, dtype="f4")

def quarters(text):
    """The same weather with a record for the middle of each quarter of an hour."""
    lines = text.splitlines()
    out = lines[:7] + [lines[7].replace("DATA PERIODS,1,1,", "DATA PERIODS,1,4,")]
    for line in lines[8:]:
        words = line.split(",", 5)
        out += [",".join(words[:4] + [str(minute), words[5]]) for minute in (8, 23, 38, 53)]
    return "\n".join(out) + "\n"

def michalsky(minute, year, latitude, longitude, zone):
    """Direction to the sun, east, north and up, at a minute of a year (Michalsky, Solar Energy 40, 1988), as by gensky -y."""
    ut = minute - 60*zone
    n = 365*(year-2001) + (year-2001)//4 + ut/1440 + 365.5
    length, mean = (280.460 + .9856474*n) % 360, math.radians((357.528 + .9856003*n) % 360)
    ecliptic = math.radians(length + 1.915*math.sin(mean) + .020*math.sin(2*mean))
    tilt = math.radians(23.439 - 4e-7*n)
    ascension = math.atan2(math.cos(tilt)*math.sin(ecliptic), math.cos(ecliptic))
    declination = math.asin(math.sin(tilt)*math.sin(ecliptic))
    hour = math.radians((6.697375 + .0657098242*n + ut/60) % 24 * 15 + longitude) - ascension
    f, c = math.radians(latitude), math.cos(declination)
    return (-c*math.sin(hour), math.sin(declination)*math.cos(f) - c*math.sin(f)*math.cos(hour),
            math.sin(declination)*math.sin(f) + c*math.cos(f)*math.cos(hour))

def suns(text, points):
    """Illuminance of the points by the sun alone in each hour, from the sun of each quarter in its place, twice: where gendaymtx has
    the sun, whose formula puts it up to 1 degree too low in spring and autumn, and where Michalsky's algorithm has it."""
    pathlib.Path("q.epw").write_text(quarters(text))
    subprocess.run(["gendaymtx", "-n", "-D", "q.rad", "-M", "q.mod", "q.epw"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                   check=True, env=ENV)
    names = pathlib.Path("q.mod").read_text().split()
    minutes = [int(name[len("solar"):]) for name in names]
    place = [float(x) for x in text.splitlines()[0].split(",")[6:9]]
    month = lambda minute: next(m for m in range(12) if minute < 1440*sum(DAYS[:m+1]))
    years = {int(w[1])-1: int(w[0]) for w in (line.split(",", 2) for line in text.splitlines()[8:])}
    def moved(minute):
        m = month(minute); leap = years[m] % 4 == 0 and m > 1
        return michalsky(minute + 1440*leap, years[m], *place)
    found = []
    for accurate in (False, True):
        if accurate:
            lines, k = pathlib.Path("q.rad").read_text().splitlines(), 0
            for i, line in enumerate(lines):
                if line.startswith("4 "):
                    lines[i] = "4 %.6f %.6f %.6f 0.5330" % moved(minutes[k]); k += 1
            pathlib.Path("q.rad").write_text("\n".join(lines) + "\n")
        with open("q.oct", "wb") as out:
            subprocess.run(["oconv", "s.rad", "q.rad"], stdout=out, check=True, env=ENV)
        out = subprocess.run(["rcontrib", "-I+", "-h", "-faf", "-ab", "0", "-dt", "0", "-dc", "1", "-ds", "0", "-dj", "0", "-V+", "-M",
                              "q.mod", "q.oct"], input=pathlib.Path("p.txt").read_bytes(), stdout=subprocess.PIPE, check=True, env=ENV)
        values = np.frombuffer(out.stdout, dtype="<f4").reshape(len(points), len(names), 3) @ np.array(LUMINANCE, dtype="f4")
        hours = np.zeros((len(points), 8760))
        for k, minute in enumerate(minutes):
            hours[:, minute//60] += values[:, k] / 4
        found.append(hours)
    return found

def year(program, weather):
    """Every hour of a year in a room with a window, by RADIANCE's daylight coefficients and by `radiosity daylight`.

    RADIANCE spreads the sun over the four nearest parts of the sky. With Tregenza's 145 parts the sun of a year then reaches points
    beside a window frame that it does not reach, and misses others, by 14 % of the mean of a year. So the sky has 2305 parts, and
    the second comparison takes direct sunlight from suns in their places instead (the direct-sun method of RADIANCE's manuals)."""
    points = [(x, y, .8, 0, 0, 1) for y in (.5, 1.0, 1.5, 2.0, 2.5) for x in (.5, 1.25, 2, 2.75, 3.5)]
    text = pathlib.Path(weather).read_text(errors="replace") if weather else made_weather()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        pathlib.Path("s.rad").write_text(as_files(room()))
        pathlib.Path("w.epw").write_text(text)
        pathlib.Path("p.txt").write_text("".join(" ".join(map(str, p)) + "\n" for p in points))
        start = time.time()
        parts = coefficients(points, 8)
        sky, sun = skies("-s"), skies("-d")
        spread = parts @ (sky + sun)
        seconds = time.time() - start
        without = parts @ sky + (parts - coefficients(points, 1)) @ sun
        theirs, moved = [without + direct for direct in suns(text, points)]
        start = time.time()
        run([program, "daylight", "s.obj", "--up", "z", "--points", "p.txt", "-o", "o.npz", "--epw", "w.epw",
             "--rays-of-points", "32768", "--quiet"])
        own_seconds = time.time() - start
        own = np.load("o.npz")
        ours, found = own["illuminance"].T, own["coefficients"]
        os.chdir("/")
    sums = found.sum(1) / parts[:, 1:].sum(1) - 1
    print(f"a uniform sky at the points: differences from {100*sums.min():+.2f} to {100*sums.max():+.2f} %")
    for name, of in (("spread over four parts", spread), ("in its place", theirs), ("where Michalsky has it", moved)):
        off = ours.mean(1) / of.mean(1) - 1
        print(f"mean of {ours.shape[1]} hours at {len(points)} points, RADIANCE with the sun {name}: differences from "
              f"{100*off.min():+.2f} to {100*off.max():+.2f} %, {100*(ours.mean()/of.mean()-1):+.2f} % in the mean")
        print("   ", " ".join(f"{100*x:+.1f}" for x in off))
    work = (own["hours"][:, 2] >= 9) & (own["hours"][:, 2] <= 18)
    autonomy = (theirs[:, work] >= 300).mean(1)
    print(f"autonomy at the points: RMS difference {math.sqrt(((autonomy-own['autonomy'])**2).mean()):.3f}")
    print(f"seconds: RADIANCE with the sun spread {seconds:.0f}, radiosity {own_seconds:.0f}")
    return 0 if abs(ours.mean(1)/theirs.mean(1)-1).max() < .05 else 1

def main():
    program, worst = os.path.abspath(sys.argv[1]), 0
    if sys.argv[2:3] == ["--year"]:
        return year(program, os.path.abspath(sys.argv[3]) if sys.argv[3:] else None)
    for name, (faces, points, light) in SCENES.items():
        if sys.argv[2:] and not any(word in name for word in sys.argv[2:]):
            continue
        with tempfile.TemporaryDirectory() as folder:
            os.chdir(folder)
            pathlib.Path("my.cal").write_text(CAL)
            rad, options = light()
            pathlib.Path("s.rad").write_text(rad + as_files(faces()))
            pathlib.Path("p.txt").write_text("".join(" ".join(map(str, p)) + "\n" for p in points))
            with open("s.oct", "wb") as out:
                subprocess.run(["oconv", "s.rad"], stdout=out, check=True, env=ENV)
            found = run(["rtrace", "-I", "-h", "-ab", "6", "-ad", "65536", "-as", "0", "-aa", "0", "-lw", "1e-7", "-lr", "0", "-ds", "0.02", "-dj", "0.7", "-dc", "1", "-dt", "0", "s.oct"],
                        REPEATS * pathlib.Path("p.txt").read_text())
            green = [float(line.split()[1]) for line in found.splitlines() if len(line.split()) == 3]
            radiance = [sum(green[k::len(points)]) / REPEATS for k in range(len(points))]
            own = run([program, "probe", "s.obj", "--up", "z", "--points", "p.txt", "--spp", "262144", "--quiet"] + options)
            ours = [float(line.split()[7]) for line in own.splitlines()]
            off = [b/a-1 for a, b in zip(radiance, ours)]
            worst = max([worst] + [abs(x) for x in off])
            rms = math.sqrt(sum(x*x for x in off)/len(off))
            print(f"{name}: {len(off)} points, largest difference {100*max(off, key=abs):+.2f} %, RMS {100*rms:.2f} %", flush=True)
            for p, a, b in zip(points, radiance, ours):
                print("   ", p, "RADIANCE %.5g  radiosity %.5g" % (a, b))
            os.chdir("/")
    return 0 if worst < .01 else 1

sys.exit(main())
