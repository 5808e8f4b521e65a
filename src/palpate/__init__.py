"""palpate"""
