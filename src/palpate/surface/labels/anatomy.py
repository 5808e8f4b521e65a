"""What the name of a label states: the kind of tissue, and about one in which it lies, its lesion, vessel or part.

Names are those of TotalSegmentator, AMOS, BTCV, MSD and the terminologies of 3D Slicer, in any spelling.
"""

from __future__ import annotations

import re
import unicodedata
from enum import Enum

# nouns and adjectives of organs, in English and Latin, and some of other languages
ORGAN_WORDS = {
    "liver": "liver hepatic hepatis hepar portal leber foie higado",
    "spleen": "spleen splenic lien milz",
    "kidney": "kidney renal ren niere rein",
    "lung": "lung pulmonary pulmo lunge poumon",
    "pancreas": "pancreas pancreatic pankreas",
    "stomach": "stomach gastric magen estomac",
    "heart": "heart cardiac cor coronary herz coeur",
    "brain": "brain cerebral cerebrum gehirn cerveau",
    "prostate": "prostate prostatic prostata",
    "uterus": "uterus uterine",
    "ovary": "ovary ovaries ovarian",
    "testis": "testis testes testicle",
    "bladder": "bladder vesica",
    "gallbladder": "gallbladder cholecyst",
    "breast": "breast mammary mamma",
    "colon": "colon colonic",
    "rectum": "rectum rectal",
    "bowel": "bowel intestine intestinal",
    "duodenum": "duodenum duodenal",
    "oesophagus": "oesophagus esophagus oesophageal esophageal",
    "adrenal": "adrenal suprarenal",
    "aorta": "aorta aortic arota",
    "cava": "cava postcava precava ivc svc",
    "vertebra": "vertebra vertebrae vertebral",
    "sacrum": "sacrum sacral",
    "rib": "rib costal",
    "clavicle": "clavicle clavicula",
    "gluteus": "gluteus gluteal",
}
# parts that name their organ by themselves
PART_WORDS = {
    "heart": "atrium atrial atria myocardium",
    "brain": "cerebellum brainstem hippocampus thalamus",
    "lung": "bronchus bronchi bronchia",
    "uterus": "cervix endometrium",
    "colon": "sigmoid caecum cecum",
    "bowel": "jejunum ileum",
}
# other organs, bones, muscles and vessels of their own, each with one word
OTHER_WORDS = (
    "thyroid thymus ureter urethra trachea larynx pharynx iliac carotid subclavian brachiocephalic celiac coeliac "
    "mesenteric lymph parotid submandibular pituitary tongue tonsil eye eyeball skull mandible spinalcord sternum hip "
    "pelvis femur humerus scapula tibia fibula patella bone muscle autochthon iliopsoas psoas diaphragm skin"
)
ORGAN_BY_WORD = {
    **{word: organ for table in (ORGAN_WORDS, PART_WORDS) for organ, words in table.items() for word in words.split()},
    **{word: word for word in OTHER_WORDS.split()},
}
PART_NAMES = frozenset(" ".join(PART_WORDS.values()).split())
MIN_STEM = 5  # letters of an organ at the beginning of a longer word, such as "livertumor"
TWO_WORDS = {
    "gall bladder": "gallbladder", "spinal cord": "spinalcord", "small intestine": "bowel", "large intestine": "colon",
    "renal pelvis": "renal calyx",
}  # fmt: skip
SIDES = {
    "left": "left l lt links gauche sinister sinistra",
    "right": "right r rt rechts droit droite dexter dextra",
}
SIDE_BY_WORD = {word: side for side, words in SIDES.items() for word in words.split()}
# of solid lesions, and of those that hold fluid or are as soft as the organ: parts of words, and whole words
SOLID_STEMS = ("tumor", "tumour", "tumeur", "lesion", "lasion", "neoplas", "carcino", "cancer", "metasta", "nodul",
               "sarcoma", "melanoma", "blastoma", "lymphom")  # fmt: skip
SOLID_WORDS = {"mass", "masses", "met", "mets", "hcc", "gtv", "gtvp", "polyp", "polyps"}  # also with a number: "GTV1"
SOFT_STEMS = ("cyst", "zyst", "kyst", "abscess", "abszess", "angiom", "adenoma", "hematoma", "haematoma")
NO_CYSTS = ("cystic duct", "cystic artery", "cystic vein", "cholecyst")
VESSEL_STEMS = ("vessel", "vascul", "arter", "vene")
VESSEL_WORDS = {"vein", "veins", "vena", "venous", "duct", "ducts", "bile", "biliary"}
# kinds of tissue: names are those of `ORGAN_BY_WORD`, and words further ones that state the kind alone
BONE_NAMES = {"vertebra", "sacrum", "rib", "clavicle", "skull", "mandible", "sternum", "hip", "pelvis", "femur",
              "humerus", "scapula", "tibia", "fibula", "patella", "bone"}  # fmt: skip
BONE_WORDS = {"cartilage", "cartilages", "cranium", "spine", "disc", "discs", "ulna", "radius", "tarsal", "carpal",
              "metatarsal", "metacarpal", "phalanges", "coccyx", "maxilla", "teeth", "tooth", "calvaria"}  # fmt: skip
VESSEL_NAMES = {"aorta", "cava", "iliac", "carotid", "subclavian", "brachiocephalic", "celiac", "coeliac", "mesenteric"}
MUSCLE_NAMES = {"gluteus", "muscle", "autochthon", "iliopsoas", "psoas", "diaphragm"}
MUSCLE_WORDS = {"quadriceps", "sartorius", "deltoid", "trapezius", "pectoralis", "serratus", "latissimus", "rectus",
                "oblique", "hamstrings", "adductor", "supraspinatus", "infraspinatus", "subscapularis"}  # fmt: skip
OTHER_NAMES = {"skin", "spinalcord", "lymph"}
# words that name no organ, and no place in one
GENERAL_WORDS = {"label", "segment", "seg", "segmentation", "roi", "mask", "organ", "class", "structure", "region",
                 "object", "the", "of", "in", "and", "whole", "urinary"}  # fmt: skip


class Relation(Enum):
    """What a label is of the organ in which it lies, by its name."""

    LESION = "lesion"
    VESSEL = "vessel"
    PART = "part"
    UNKNOWN = ""
    OTHER = "another organ"


def relation(inner: str, organ: str) -> Relation:
    """Return what a label of a name is of an organ of another name, such as LESION for a cyst of a kidney."""
    organs, other_organs = organs_of(organ), organs_of(inner)
    sides, other_sides = _sides(organ), _sides(inner)
    if (organs and other_organs and not organs & other_organs) or (sides and other_sides and not sides & other_sides):
        return Relation.OTHER
    if is_lesion(inner):
        return Relation.LESION
    if _is_vessel(inner):
        return Relation.VESSEL
    words = _words(organ)
    if organs and words <= _words(inner):
        return Relation.PART
    return Relation.OTHER if other_organs else Relation.UNKNOWN


class Tissue(Enum):
    """The kind of tissue of a label, by its name."""

    BONE = "bone"
    VESSEL = "vessel"
    ORGAN = "organ"
    MUSCLE = "muscle"
    OTHER = "other"


def tissue_of(name: str) -> Tissue:
    """Return the kind of tissue of a label, such as BONE for ``"rib_left_7"``; OTHER for a name without anatomy."""
    organs, words = organs_of(name), set(_text(name).split())
    if is_lesion(name):
        return Tissue.ORGAN
    if organs & MUSCLE_NAMES or words & MUSCLE_WORDS:
        return Tissue.MUSCLE
    if _is_vessel(name) or organs & VESSEL_NAMES:
        return Tissue.VESSEL
    if organs & BONE_NAMES or words & BONE_WORDS:
        return Tissue.BONE
    return Tissue.ORGAN if organs - OTHER_NAMES else Tissue.OTHER


def is_lesion(name: str) -> bool:
    """Return True for the name of a lesion."""
    return _is_solid(name) or _is_soft(name)


def is_stiff_lesion(name: str) -> bool:
    """Return True for the name of a solid lesion, and False for that of a cyst, an abscess or a benign one."""
    return _is_solid(name) and not _is_soft(name)


def _is_solid(name: str) -> bool:
    text = _text(name)
    words = {word.rstrip("0123456789") for word in text.split()}
    return any(stem in text for stem in SOLID_STEMS) or not SOLID_WORDS.isdisjoint(words)


def _is_soft(name: str) -> bool:
    text = _text(name)
    return any(stem in text for stem in SOFT_STEMS) and not any(each in text for each in NO_CYSTS)


def _is_vessel(name: str) -> bool:
    text = _text(name)
    return any(stem in text for stem in VESSEL_STEMS) or not VESSEL_WORDS.isdisjoint(text.split())


def _text(name: str) -> str:
    """Return a name in small letters without accents, its words separated by spaces."""
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)
    plain = unicodedata.normalize("NFKD", spaced).encode("ascii", "ignore").decode().lower()
    text = " ".join(re.findall(r"[a-z0-9]+", plain))
    for words, word in TWO_WORDS.items():
        text = text.replace(words, word)
    return text


def _organ_of(word: str) -> str:
    """Return the organ of a word, also of a plural and of a longer word that begins with it; empty without one."""
    known = ORGAN_BY_WORD.get(word) or ORGAN_BY_WORD.get(word.removesuffix("s"))
    if known or word.startswith((*SOLID_STEMS, *SOFT_STEMS)):
        return known or ""
    return next((organ for stem, organ in ORGAN_BY_WORD.items() if len(stem) >= MIN_STEM and word.startswith(stem)), "")


def organs_of(name: str) -> set[str]:
    """Return the organs that a name states, such as ``{"liver"}``."""
    return {organ for word in _text(name).split() if (organ := _organ_of(word))}


def _sides(name: str) -> set[str]:
    return {SIDE_BY_WORD[word] for word in _text(name).split() if word in SIDE_BY_WORD}


def _words(name: str) -> set[str]:
    """Return the words that tell a name from others: one for all of an organ or a side, and those of parts."""
    words = set(_text(name).split()) - GENERAL_WORDS
    return {_organ_of(word) or SIDE_BY_WORD.get(word, word) for word in words} | (words & PART_NAMES)
